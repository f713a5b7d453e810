// Keep: clips of the store, files made of them, recordings. Files are made by the server, whether or not
// this page is open.
import { html, useEffect, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { Files, jobsGoOn, lookAtJobs, Making } from "./files.js";
import { changed, known } from "./known.js";
import { past, playStretch } from "./past.js";
import { line, zoomOver } from "./timeline.js";
import { bytesWords, clock, duration } from "./words.js";

const LOOK_MS = 1000, RARELY_MS = 10_000;
export const mayKeep = () => known.room.scope === "write";
export const keeps = () => known.room.stored || known.room.recorded;
const kept = { recordings: [], said: "" };

const localText = (t) => new Date(1000 * t - new Date(1000 * t).getTimezoneOffset() * 60_000).toISOString().slice(0, 19);
const here = () => (known.mode === "past" ? past.at_s : Date.now() / 1000);
const whole = (s) => Math.round(1000 * s) * 1e6; // nanoseconds, as a number

async function look() {
  try {
    if (known.room.stored) known.clips = (await ask("/api/clips")).map((clip) => ({ ...clip, from_s: clip.start_ns / 1e9, to_s: clip.end_ns / 1e9 }));
    if (known.room.recorded) kept.recordings = await ask("/api/recordings");
  } catch (error) {
    kept.said = error.message;
  }
  changed();
}

// Ask for a change, say what became of it, and look again.
async function change(path, body, method) {
  try {
    kept.said = (await ask(path, body, method)).said || "";
  } catch (error) {
    kept.said = error.message;
    changed();
    return null;
  }
  await look();
  return true;
}

// Mark a stretch: what is shown on the time line, dragged there or typed here.
export function mark(from_s, to_s) {
  line.marked = { from_s: Math.min(from_s, to_s), to_s: Math.max(from_s, to_s) };
  changed();
}

function Marking() {
  const [name, setName] = useState(""), [note, setNote] = useState(""), { marked } = line;
  if (!mayKeep()) return html`<p class="soft">Marking and making files needs the write token.</p>`;
  const set = (end) => ({ target }) => {
    const t = new Date(target.value).getTime() / 1000, other = marked || { from_s: t - 10, to_s: t + 10 };
    if (Number.isFinite(t)) mark(end === "from" ? t : Math.min(other.from_s, t - 1), end === "from" ? Math.max(other.to_s, t + 1) : t);
  };
  const save = async (event) => {
    event.preventDefault();
    if (await change("/api/control/clips", { name, note, start_ns: whole(marked.from_s), end_ns: whole(marked.to_s) })) {
      line.marked = null;
      setName("");
      setNote("");
    }
  };
  return html`<form id="marking" onSubmit=${save}>
    <p class="soft">Drag on the time line to mark a stretch, or set its ends here.</p>
    <div class="ends"><label for="from">From</label><input id="from" type="datetime-local" step="1" value=${marked ? localText(marked.from_s) : ""} onChange=${set("from")} />
      <button type="button" id="from-here" aria-label="From here, the moment shown" onClick=${() => mark(here(), Math.max(marked?.to_s ?? 0, here() + 10))}>here</button>
      <label for="to">To</label><input id="to" type="datetime-local" step="1" value=${marked ? localText(marked.to_s) : ""} onChange=${set("to")} />
      <button type="button" id="to-here" aria-label="To here, the moment shown" onClick=${() => mark(Math.min(marked?.from_s ?? Infinity, here() - 1), here())}>here</button>
      <span class="soft">${marked ? duration(marked.to_s - marked.from_s) : ""}</span></div>
    <label>Name <input id="clip-name" required maxlength="100" value=${name} onInput=${({ target }) => setName(target.value)} /></label>
    <label>Note <input id="clip-note" maxlength="1000" value=${note} onInput=${({ target }) => setNote(target.value)} /></label>
    <div class="row"><button type="submit" id="clip-save" disabled=${!marked || !name.trim()}>Keep this clip</button>
      ${marked && html`<button type="button" onClick=${() => playStretch(marked.from_s, marked.to_s)}>Play</button>
      <button type="button" onClick=${() => ((line.marked = null), changed())}>Clear</button>`}</div>
  </form>`;
}

function Clip({ clip, open, opened }) {
  const [doing, setDoing] = useState(""), [typed, type] = useState({ name: clip.name, note: clip.note });
  const path = `/api/control/clips/${clip.number}`, toggle = (what) => () => setDoing(doing === what ? "" : what);
  const play = () => (mark(clip.from_s, clip.to_s), zoomOver(clip.from_s, clip.to_s), playStretch(clip.from_s, clip.to_s));
  const save = async (event) => {
    event.preventDefault();
    if (await change(path, typed)) setDoing("");
  };
  return html`<li class="clip">
    <b>${clip.name}</b><span class="soft">${clock(clip.from_s)} · ${duration(clip.to_s - clip.from_s)}${clip.stored ? "" : " · no longer stored"}</span>
    ${clip.note && html`<p class="note">${clip.note}</p>`}
    <div class="row"><button type="button" aria-label=${`Play ${clip.name}`} disabled=${!clip.stored} onClick=${play}>▶ Play</button>
      ${mayKeep() && html`<button type="button" aria-label=${`Download … of ${clip.name}`} aria-expanded=${opened} disabled=${!clip.stored} onClick=${open}>Download …</button>
      <button type="button" aria-label=${`Edit ${clip.name}`} onClick=${toggle("edit")}>Edit</button>
      <button type="button" aria-label=${`Delete ${clip.name}`} onClick=${toggle("delete")}>Delete</button>`}</div>
    ${doing === "edit" && html`<form onSubmit=${save}><label>Name <input aria-label="New name" required maxlength="100" value=${typed.name} onInput=${({ target }) => type({ ...typed, name: target.value })} /></label>
      <label>Note <input aria-label="New note" maxlength="1000" value=${typed.note} onInput=${({ target }) => type({ ...typed, note: target.value })} /></label><button type="submit">Save</button></form>`}
    ${doing === "delete" && html`<div class="sure"><p>Remove the clip from this list, or also delete the stored poses of its time? That cannot be undone.</p>
      <div class="row"><button type="button" onClick=${() => change(path, undefined, "DELETE")}>Remove from the list</button>
      <button type="button" class="grave" onClick=${() => change(`${path}?stored=true`, undefined, "DELETE")}>Delete ${duration(clip.to_s - clip.from_s)} of the store</button>
      <button type="button" onClick=${toggle("delete")}>Cancel</button></div></div>`}
    ${opened && html`<${Making} key=${clip.number} stretch=${clip} />`}
  </li>`;
}

function Recording({ one }) {
  const [sure, ask_first] = useState(false), from_s = one.start_ns === null ? null : one.start_ns / 1e9;
  return html`<li class="clip"><b>${from_s === null ? one.name : clock(from_s)}</b>
    <span class="soft">${duration(one.seconds)} · ${bytesWords(one.bytes)}${one.videos ? ` · videos of ${one.videos} cameras` : ""}</span>
    <div class="row">${from_s !== null && known.room.stored && html`<button type="button" onClick=${() => (mark(from_s, from_s + one.seconds), zoomOver(from_s, from_s + one.seconds), playStretch(from_s, from_s + one.seconds))}>▶ Play from the store</button>`}
      ${mayKeep() && html`<button type="button" aria-label=${`Delete recording ${one.name}`} onClick=${() => ask_first(!sure)}>Delete</button>`}</div>
    ${sure && html`<div class="sure"><p>Delete this recording? Its keypoints and videos are gone then.</p><div class="row"><button type="button" class="grave" onClick=${() => change(`/api/control/recordings/${encodeURIComponent(one.name)}`, undefined, "DELETE")}>Delete</button> <button type="button" onClick=${() => ask_first(false)}>Cancel</button></div></div>`}
  </li>`;
}

export function Keep() {
  const [opened, open] = useState(null);
  useEffect(() => {
    look();
    lookAtJobs();
    let waited_ms = 0;
    const timer = setInterval(() => {
      waited_ms += LOOK_MS;
      if (document.hidden || (!jobsGoOn() && waited_ms < RARELY_MS)) return;
      waited_ms = 0;
      lookAtJobs();
    }, LOOK_MS);
    return () => clearInterval(timer);
  }, []);
  const { clips, room } = known;
  return html`<section id="keep" aria-label="Keep">
    <p id="kept-said" class="soft" role="status">${kept.said}</p>
    ${room.stored && html`<h2>Mark</h2><${Marking} />
      ${line.marked && mayKeep() && html`<details id="at-once"><summary>Make files of what is marked</summary><${Making} stretch=${{ ...line.marked, name: "poses" }} /></details>`}
      <h2>Clips</h2><ul id="clips">${clips.length ? clips.map((clip) => html`<${Clip} key=${clip.number} clip=${clip} opened=${opened === clip.number} open=${() => open(opened === clip.number ? null : clip.number)} />`) : html`<li class="soft">No clips yet.</li>`}</ul>
      <h2>Files</h2><${Files} />`}
    ${room.recorded && html`<h2>Recordings</h2><p class="soft">Recordings of the site; the oldest are deleted to make room.</p>
      <ul id="recordings">${kept.recordings.length ? kept.recordings.map((one) => html`<${Recording} key=${one.name} one=${one} />`) : html`<li class="soft">No recordings.</li>`}</ul>`}
  </section>`;
}
