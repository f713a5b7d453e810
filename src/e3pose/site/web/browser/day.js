// A person's day across the numbers that the tracker gave: when somebody was there, in which zones, what
// happened; for operators also the name and the colour.
import { html, useEffect, useLayoutEffect, useRef, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { known } from "./known.js";
import { occurrences, sentence } from "./happened.js";
import { called, COLOUR_WORDS, learnNames, nameOf, ofRow, whoIs } from "./names.js";
import { sceneInks } from "./palette.js";
import { seek } from "./past.js";
import { article, duration, hourOf, midnight, nanoseconds } from "./words.js";

const MOST_ROWS = 5000, DAY_S = 86_400, APART_S = 60, MOST_STRETCHES = 8;

// What the store knows of a person on a day: the stretches of time there, and stays in zones.
async function dayOf(track, run, day_s) {
  const range = `start=${nanoseconds(day_s)}&end=${nanoseconds(day_s + DAY_S)}&limit=${MOST_ROWS}`;
  const [tracks, zones] = await Promise.all([ask(`/api/tracks?${range}`), ask(`/api/zones?${range}`)]);
  learnNames(tracks.rows.map(ofRow));
  const mine = ({ track_id, run_id }) => whoIs(track_id, run_id) === whoIs(track, run);
  const there = tracks.rows.filter(mine).map((row) => [Math.max(row.first_ns / 1e9, day_s), row.last_ns / 1e9]).sort((a, b) => a[0] - b[0]);
  const stretches = [];
  for (const [from_s, to_s] of there) {
    if (stretches.length && from_s - stretches.at(-1)[1] < APART_S) stretches.at(-1)[1] = Math.max(stretches.at(-1)[1], to_s);
    else stretches.push([from_s, to_s]);
  }
  return { stretches, stays: zones.rows.filter((row) => row.kind === "leave" && mine(row)) };
}

// Seconds in each zone, longest first.
function zoneTimes(stays, does, now_s) {
  const times = new Map();
  const add = (zone, s) => times.set(zone, (times.get(zone) || 0) + s);
  for (const { zone, stayed_s } of stays) add(zone, stayed_s);
  for (const { name, since_ns } of does?.zones || []) add(name, now_s - since_ns / 1e9);
  return [...times].sort((a, b) => b[1] - a[1]);
}

const mayName = () => known.room.stored && known.room.scope === "write";

// Name and colour, which operators change: of the person, or of this track where it is somebody else's.
function Called({ track, run, done }) {
  const now = called(track, run), [typed, type] = useState({}), [said, say] = useState(""), [others, setOthers] = useState([]);
  useEffect(() => void ask("/api/people").then(setOthers, () => {}), []);
  const name = typed.name ?? now.name ?? "", colour = typed.colour ?? now.colour ?? "", only = Boolean(typed.only);
  const mine = others.find((one) => one.name === now.name), known_already = name !== now.name && others.some((one) => one.name === name);
  const save = async (event) => {
    event.preventDefault();
    const body = { run, track, only, ...(name === (now.name ?? "") ? {} : { name }), ...(typed.colour === undefined ? {} : { colour }) };
    try {
      say((await ask("/api/control/people", body)).said);
      const people = await ask("/api/people");
      const before = mine && !only ? mine.tracks : [{ run, track }];
      learnNames(before.map((one) => ({ ...one, name: null, colour: typed.colour ?? now.colour })));
      learnNames(people.flatMap((one) => one.tracks.map((of) => ({ ...of, name: one.name, colour: one.colour }))));
      setOthers(people);
      type({});
      done();
    } catch (error) {
      say(error.message);
    }
  };
  const swatch = (word, index) => html`<label class="colour" title=${word || "by number"}><input type="radio" name="colour" value=${word} aria-label=${word || "colour by number"} checked=${colour === word} onChange=${() => type({ ...typed, colour: word })} />
    <i class="swatch" style=${{ background: index < 0 ? "none" : sceneInks().colours[index] }}>${index < 0 ? "–" : ""}</i></label>`;
  return html`<form id="called" onSubmit=${save}>
    <label>Name <input id="name" list="names" maxlength="100" autocomplete="off" value=${name} placeholder=${`Person ${track}`} onInput=${({ target }) => type({ ...typed, name: target.value })} /></label>
    <datalist id="names">${others.map((one) => html`<option value=${one.name}></option>`)}</datalist>
    <div id="colours" role="radiogroup" aria-label="Colour">${swatch("", -1)}${COLOUR_WORDS.map(swatch)}</div>
    ${mine?.tracks.length > 1 && html`<label class="tick"><input id="only" type="checkbox" checked=${only} onChange=${({ target }) => type({ ...typed, only: target.checked })} /> Only here: ${now.name} was taken for somebody else</label>`}
    <p class="soft" role="status" id="called-said">${said || (known_already ? `${name} is known already: both are then the same person.` : "")}</p>
    <button type="submit" disabled=${name === (now.name ?? "") && typed.colour === undefined}>Save</button>
  </form>`;
}

export function PersonsDay({ track, run, close }) {
  const box = useRef(null), [day, setDay] = useState(undefined), [why, setWhy] = useState("");
  const shown_s = known.shown?.t ?? Date.now() / 1000, [day_s] = useState(midnight(shown_s)), now_s = shown_s;
  const look = () => (known.room.stored ? dayOf(track, run, day_s).then(setDay, (error) => setWhy(error.message)) : setDay(null));
  useLayoutEffect(() => box.current.showModal(), []);
  useEffect(() => void look(), [track, run]);
  const who = whoIs(track, run), here = known.shown?.people.find((one) => whoIs(one.track) === who), now = known.mode === "live" && here;
  const since_s = day?.stretches[0]?.[0] ?? (now?.does.since_ns ? now.does.since_ns / 1e9 : null), stretches = day?.stretches || [];
  const until_s = stretches.at(-1)?.[1] ?? now_s, in_all_s = stretches.reduce((sum, [from_s, to_s]) => sum + to_s - from_s, 0);
  const did = occurrences().filter((one) => whoIs(one.track, one.run ?? known.run) === who && one.start_s >= day_s && one.start_s < day_s + DAY_S);
  const times = zoneTimes(day?.stays || [], now ? now.does : null, now_s);
  const jump = (t) => (close(), seek(t));
  const seen = () => {
    if (since_s === null) return "Not stored, and not there now.";
    const long_s = stretches.length > 1 ? in_all_s : (now ? now_s : until_s) - since_s;
    return `Seen from ${hourOf(since_s)} ${now ? "until now" : `to ${hourOf(until_s)}`}, ${duration(long_s)}${stretches.length > 1 ? " in all" : ""}.`;
  };
  return html`<dialog id="day" ref=${box} aria-labelledby="day-title" onClose=${close} onClick=${(event) => event.target === box.current && close()}>
    <h2 id="day-title">${nameOf(track, run)} ${day_s === midnight() ? "today" : `on ${new Date(1000 * day_s).toLocaleDateString([], { day: "numeric", month: "long" })}`}</h2>
    ${mayName() && run !== null && html`<${Called} track=${track} run=${run} done=${look} />`}
    <p>${why || (day === undefined ? "Looking …" : seen())}</p>
    ${stretches.length > 1 && html`<ul class="events">${stretches.slice(-MOST_STRETCHES).map(([from_s, to_s]) => html`<li><span>${hourOf(from_s)} to ${hourOf(to_s)}</span> <button type="button" class="plain" aria-label=${`Show ${hourOf(from_s)}`} onClick=${() => jump(from_s)}>Show</button></li>`)}</ul>`}
    ${times.length > 0 && html`<h3>Where</h3><ul>${times.map(([zone, s]) => html`<li>${duration(s)} in ${article(zone)}</li>`)}</ul>`}
    <h3>What happened</h3>
    <ul class="events">${did.length ? did.map((one) => html`<li>${sentence(one, now_s)} ${known.room.stored && html`<button type="button" class="plain" onClick=${() => jump(one.start_s - 5)}>Show</button>`}</li>`) : html`<li class="soft">${known.room.tells ? "Nothing that the site tells." : "Events are off. Add [events] to site.toml to turn them on."}</li>`}</ul>
    ${known.room.stored && !called(track, run).name && html`<p class="soft">A person who is lost and not recognised gets a new number. People of one name are one person.</p>`}
    <button type="button" id="day-off" autofocus onClick=${close}>Close</button>
  </dialog>`;
}
