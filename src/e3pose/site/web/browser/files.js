// Files made of a stretch of the store: choosing form and people, progress, downloads.
import { html, useEffect, useState } from "./vendor/preact.js";
import { ask, fetched } from "./connection.js";
import { changed, known } from "./known.js";
import { colourOf, learnNames, nameOf, ofRow, whoIs } from "./names.js";
import { bytesWords, clock, duration, hourOf, nanoseconds, percent, plural } from "./words.js";

const MOST_ROWS = 5000;
const files = { jobs: [], forms: [], why: "", said: "" };

export const jobsGoOn = () => files.jobs.some(({ state }) => state === "waiting" || state === "working");

export async function lookAtJobs() {
  try {
    Object.assign(files, await ask("/api/jobs"));
    files.said = files.why;
  } catch (error) {
    files.said = error.message;
  }
  changed();
}

async function send(path, body, method) {
  try {
    await ask(path, body, method);
    await lookAtJobs();
  } catch (error) {
    files.said = error.message;
    changed();
  }
}

async function download(number, name) {
  try {
    const link = document.createElement("a"), body = await (await fetched(`/api/jobs/${number}/${encodeURIComponent(name)}`)).blob();
    link.href = URL.createObjectURL(body);
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  } catch (error) {
    files.said = error.message;
    changed();
  }
}

// Who was there in a stretch: of the run that has most, as a file is of one run.
function peopleIn(rows) {
  const runs = new Map();
  for (const row of rows) runs.set(row.run_id, [...(runs.get(row.run_id) || []), row]);
  const [run, mine] = [...runs].sort((a, b) => b[1].length - a[1].length)[0] || [null, []];
  const people = new Map();
  for (const row of mine) {
    const who = whoIs(row.track_id, run), one = people.get(who) || { who, name: nameOf(row.track_id, run), colour: colourOf(row.track_id, run), tracks: [] };
    one.tracks.push(row.track_id);
    people.set(who, one);
  }
  return { run, others: runs.size - 1, people: [...people.values()] };
}

export function Making({ stretch }) {
  const { name, from_s, to_s } = stretch, [form, setForm] = useState("report"), [smooth, setSmooth] = useState(false), [left, setLeft] = useState(new Set()), [rows, setRows] = useState([]);
  useEffect(() => {
    const range = `start=${nanoseconds(from_s)}&end=${nanoseconds(to_s)}&limit=${MOST_ROWS}`;
    ask(`/api/tracks?${range}`).then((found) => (learnNames(found.rows.map(ofRow)), setRows(found.rows)), () => setRows([]));
  }, [from_s, to_s]);
  const { run, others, people } = peopleIn(rows), about = files.forms.find((one) => one.form === form);
  const chosen = people.filter(({ who }) => !left.has(who)), can_smooth = form !== "mcap";
  const toggle = (who) => () => setLeft(new Set(left.has(who) ? [...left].filter((one) => one !== who) : [...left, who]));
  const make = (event) => {
    event.preventDefault();
    const tracks = !about.chooses || chosen.length === people.length ? [] : chosen.flatMap((one) => one.tracks);
    send("/api/control/jobs", { form, name, start_ns: Math.round(1000 * from_s) * 1e6, end_ns: Math.round(1000 * to_s) * 1e6, tracks, run, smooth: smooth && can_smooth });
  };
  return html`<form class="making" onSubmit=${make}>
    <label>As <select class="form" value=${form} onChange=${({ target }) => setForm(target.value)}>${files.forms.map((one) => html`<option value=${one.form}>${one.form === "report" ? "Report page" : one.form === "gltf" ? "glTF" : one.form.length > 4 ? one.form[0].toUpperCase() + one.form.slice(1) : one.form.toUpperCase()}</option>`)}</select></label>
    <p class="soft">${about ? `For ${about.words}.` : ""}</p>
    ${about?.chooses && html`<fieldset><legend>People</legend>${people.map((one) => html`<label class="tick" key=${one.who}><input type="checkbox" checked=${!left.has(one.who)} onChange=${toggle(one.who)} /><i class="swatch" style=${{ background: one.colour }}></i>${one.name}</label>`)}
      ${!people.length && html`<span class="soft">Nobody was stored in this time.</span>`}</fieldset>`}
    ${others > 0 && html`<p class="soft">The edge restarted in this time: files contain the run with the most people.</p>`}
    ${can_smooth && html`<label class="tick"><input type="checkbox" class="smooth" checked=${smooth} onChange=${({ target }) => setSmooth(target.checked)} /> Smoothed with what came later</label>`}
    <button type="submit" class="make" disabled=${!about || (about.chooses && !chosen.length)}>Make the file</button>
  </form>`;
}

const asked = ({ request }) => {
  const people = request.tracks.length ? `, ${plural(request.tracks.length, "track")}` : "";
  return `${clock(request.start_ns / 1e9)}, ${duration((request.end_ns - request.start_ns) / 1e9)}${people}${request.smooth ? ", smoothed" : ""}`;
};

function Job({ job }) {
  const { number, request, state, share, doing } = job, goes_on = state === "waiting" || state === "working", may = known.room.scope === "write";
  const title = `${request.name} · ${request.form === "report" ? "report page" : request.form.toUpperCase()}`;
  const words = { waiting: "waiting for those before", working: `${doing || "starting"}${share === null ? "" : `, ${percent(share)}`}`, done: doing, failed: `Not made: ${doing}` }[state];
  return html`<li class="clip job ${state}"><b>${title}</b><span class="soft">${asked(job)}</span>
    ${state === "working" && html`<progress aria-label=${`Progress of ${title}`} max="1" value=${share ?? undefined}></progress>`}
    <p class=${state === "failed" ? "bad" : "soft"}>${words}</p>
    <div class="row">${job.files.map((file) => html`<button type="button" class="get" onClick=${() => download(number, file.name)}>↓ ${file.name} <small>${bytesWords(file.bytes)}</small></button>`)}
      ${may && state === "failed" && html`<button type="button" onClick=${() => send("/api/control/jobs", { ...request, tracks: request.tracks })}>Try again</button>`}
      ${may && html`<button type="button" aria-label=${`${goes_on ? "Stop" : "Remove"} ${title}`} onClick=${() => send(`/api/control/jobs/${number}`, undefined, "DELETE")}>${goes_on ? "Stop" : "Remove"}</button>`}
      ${state === "done" && html`<span class="soft">kept until ${hourOf(job.until_s)}</span>`}</div>
  </li>`;
}

export function Files() {
  return html`<p id="files-said" class="soft" role="status">${files.said}</p>
    <ul id="files">${files.jobs.length ? files.jobs.map((job) => html`<${Job} key=${job.number} job=${job} />`) : html`<li class="soft">No files yet. They are kept for a day after they were asked for.</li>`}</ul>`;
}
