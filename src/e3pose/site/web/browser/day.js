// A person's day: when somebody was there, in which zones, and what happened, as far as it is stored.
import { html, useEffect, useLayoutEffect, useRef, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { known } from "./known.js";
import { occurrences, sentence } from "./happened.js";
import { seek } from "./past.js";
import { article, duration, hourOf, midnight, nameOf, nanoseconds } from "./words.js";

const MOST_ROWS = 5000, DAY_S = 86_400;

// What the store knows of a track today: [since, until, rows of zones].
async function dayOf(track) {
  const range = `start=${nanoseconds(midnight())}&end=${nanoseconds(midnight() + DAY_S)}&limit=${MOST_ROWS}`;
  const [tracks, zones] = await Promise.all([ask(`/api/tracks?${range}`), ask(`/api/zones?${range}`)]);
  const there = tracks.rows.filter((row) => row.track_id === track).at(-1);
  if (!there) return null;
  const stays = zones.rows.filter((row) => row.track_id === track && row.run_id === there.run_id && row.kind === "leave");
  return { since_s: there.first_ns / 1e9, until_s: there.last_ns / 1e9, stays };
}

// Seconds in each zone, longest first.
function zoneTimes(stays, does, now_s) {
  const times = new Map();
  const add = (zone, s) => times.set(zone, (times.get(zone) || 0) + s);
  for (const { zone, stayed_s } of stays) add(zone, stayed_s);
  for (const { name, since_ns } of does?.zones || []) add(name, now_s - since_ns / 1e9);
  return [...times].sort((a, b) => b[1] - a[1]);
}

export function PersonsDay({ track, close }) {
  const box = useRef(null), [day, setDay] = useState(undefined), [why, setWhy] = useState("");
  useLayoutEffect(() => box.current.showModal(), []);
  useEffect(() => {
    if (known.room.stored) dayOf(track).then(setDay, (error) => setWhy(error.message));
    else setDay(null);
  }, [track]);
  const here = known.shown?.people.find((one) => one.track === track), now_s = known.shown?.t ?? Date.now() / 1000;
  const since_s = day?.since_s ?? (here?.does.since_ns ? here.does.since_ns / 1e9 : null);
  const did = occurrences().filter((one) => one.track === track && one.start_s >= midnight());
  const times = zoneTimes(day?.stays || [], here?.does, now_s);
  const jump = (one) => (close(), seek(one.start_s - 5));
  return html`<dialog id="day" ref=${box} aria-labelledby="day-title" onClose=${close} onClick=${(event) => event.target === box.current && close()}>
    <h2 id="day-title">${nameOf(track)} today</h2>
    ${why ? html`<p>${why}</p>` : day === undefined ? html`<p>Looking …</p>` : html`<p>${since_s === null ? "Not stored, and not there now." : `Seen from ${hourOf(since_s)} ${here ? `until now, for ${duration(now_s - since_s)}` : `to ${hourOf(day?.until_s ?? now_s)}`}.`}</p>`}
    ${times.length > 0 && html`<h3>Where</h3><ul>${times.map(([zone, s]) => html`<li>${duration(s)} in ${article(zone)}</li>`)}</ul>`}
    <h3>What happened</h3>
    <ul class="events">${did.length ? did.map((one) => html`<li>${sentence(one, now_s)} ${known.room.stored && html`<button type="button" class="plain" onClick=${() => jump(one)}>Show</button>`}</li>`) : html`<li class="soft">${known.room.tells ? "Nothing that the site tells." : "The site tells no events: [events] in its file turns them on."}</li>`}</ul>
    ${known.room.stored && html`<p class="soft">A person who is lost and comes back unrecognised starts a new day under another number.</p>`}
    <button type="button" id="day-off" autofocus onClick=${close}>Close</button>
  </dialog>`;
}
