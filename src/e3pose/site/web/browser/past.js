// The past on the live page: windows of the store, played by this page alone, and what was stored
// of cameras at that time in the place of their status.
import { ask } from "./connection.js";
import { learn } from "./happened.js";
import { changed, HISTORY_S, known, prepared, remember, show, showNothing } from "./known.js";
import { clock, midnight, nanoseconds } from "./words.js";

const MOST_PAGES = 10, WINDOW_S = 20, BEFORE_S = 60, SHOWN_EVENTS = 20, STATUS_S = 0.25; // seconds of a page between two tables
const GAP_S = 1, PRESENT_S = 5; // a longer gap between slots is skipped; so near the present is live

export const past = { span: null, at_s: 0, playing: false, until_s: null }; // plays to until_s, if that is set
let windowed = [], loading = 0, readings = [], logged = [], told_s = 0;
let busy = false, opened = 0, played_s = 0; // slots up to here were shown
const days = new Map(); // midnight to until when its events were asked for

export async function findSpan() {
  const runs = await ask("/api/runs");
  if (runs.length) past.span = { begin_s: runs[0].started_ns / 1e9, runs: new Map(runs.map((run) => [run.run, run])) };
  changed();
}

export const end_s = () => Math.max(Date.now() / 1000 - 1, past.span.begin_s + 1);

// Ask for the events of people of a day up to a time, as far as that was not done yet.
export async function learnDay(t) {
  const day_s = midnight(t), from_s = days.get(day_s) ?? day_s;
  if (from_s >= t) return;
  days.set(day_s, t);
  for (let page = 0, cursor = ""; page < MOST_PAGES && cursor !== null; page++) {
    const found = await ask(`/api/events?start=${nanoseconds(from_s)}&end=${nanoseconds(t)}&limit=5000${cursor && `&cursor=${cursor}`}`);
    learn(found.rows.filter((row) => row.phase != null), "stored");
    cursor = found.cursor;
  }
}

async function load(from_s, history_s) {
  const asked = ++loading, range = `start=${nanoseconds(from_s - history_s)}&end=${nanoseconds(from_s + WINDOW_S)}`;
  const earlier = `start=${nanoseconds(from_s - BEFORE_S)}&end=${nanoseconds(from_s + WINDOW_S)}&limit=5000`;
  const [poses, rows, energy, events] = await Promise.all([
    ask(`/api/poses?limit=2000&doing=true&${range}`), ask(`/api/slots?limit=5000&${range}`), ask(`/api/energy?${earlier}`), ask(`/api/events?${earlier}`),
  ]);
  if (asked !== loading) return;
  [readings, logged] = [energy.rows, events.rows.filter((row) => row.phase == null)];
  learn(events.rows.filter((row) => row.phase != null), "stored");
  learnDay(from_s).catch(() => days.delete(midnight(from_s)));
  const people = new Map(poses.slots.map((slot) => [`${slot.run}.${slot.slot}`, slot.people]));
  const until_s = poses.cursor ? poses.slots.at(-1).time_ns / 1e9 : Infinity; // of later slots the people are not here yet
  windowed = rows.rows.filter((row) => row.time_ns / 1e9 <= until_s).map((row) => {
    const run = past.span.runs.get(row.run_id);
    const names = (flags) => (run ? run.cameras.filter((_, index) => flags[index] === "1") : []);
    const found = people.get(`${row.run_id}.${row.slot}`) || [];
    const slot = prepared({ slot: row.slot, time_ns: row.time_ns, people: found, blind: row.blind }, names(row.selected), names(row.arrived));
    return Object.assign(slot, { row, cameras: run ? run.cameras : [], run: row.run_id, limbs: run?.limbs, neck: run?.neck });
  });
}

function say(text) {
  known.notice = text;
  changed();
}

// Load what is stored from a time on. Where there is nothing, say so: a drag there shows nothing and
// waits; playing goes on at the next slot, or ends.
async function playFrom(from_s, dragged) {
  const asked = ++opened, current = () => known.mode === "past" && asked === opened;
  busy = true;
  try {
    await load(from_s, dragged ? HISTORY_S : 0);
    if (!current()) return;
    const here = windowed.filter(({ t }) => t >= from_s - GAP_S);
    if (!here.length) windowed = [];
    if (windowed.length) return say("");
    const next = (await ask(`/api/slots?limit=1&start=${nanoseconds(from_s)}`)).rows[0];
    if (!current()) return;
    if (dragged) {
      setPlaying(false);
      say(`No slot is stored at ${clock(from_s)}. ${next ? `The next one is of ${clock(next.time_ns / 1e9)}: play to go on there.` : "Nothing is stored after it."}`);
    } else if (next) {
      [past.at_s, played_s] = [next.time_ns / 1e9 - 0.002, -Infinity];
      await load(past.at_s, 0);
      say("");
    } else if (end_s() - from_s < PRESENT_S) {
      goLive();
    } else {
      setPlaying(false);
      say(`Nothing is stored after ${clock(from_s)}.`);
    }
  } catch (error) {
    setPlaying(false);
    say(error.message);
  } finally {
    if (asked === opened) busy = false;
  }
}

export function setPlaying(on) {
  past.playing = on;
  changed();
}

export async function seek(to_s) {
  known.mode = "past";
  [past.at_s, played_s, windowed] = [to_s, -Infinity, []];
  [past.playing, past.until_s] = [true, null];
  showNothing();
  known.told = unknownStatus();
  say("");
  await playFrom(to_s, true);
}

// Play a stretch and stop at its end.
export async function playStretch(from_s, to_s) {
  const opening = seek(from_s);
  past.until_s = to_s;
  await opening;
}

export function goLive() {
  known.mode = "live";
  past.playing = false;
  opened++;
  showNothing();
  known.told = known.status;
  say("");
}

// Go on by some seconds, where it plays.
export function playPast(passed_s) {
  const next = windowed.find(({ t }) => t > played_s), last_s = windowed.length ? windowed.at(-1).t : past.at_s;
  past.at_s += past.playing && !busy ? passed_s : 0;
  if (past.playing && next && next.t - past.at_s > GAP_S) past.at_s = next.t;
  const due = windowed.filter(({ t }) => t > played_s && t <= past.at_s);
  due.forEach((slot, index) => (index === due.length - 1 ? show(slot) : remember(slot)));
  if (due.length) {
    played_s = known.shown.t;
    if (known.shown.t === last_s || Math.abs(known.shown.t - told_s) >= STATUS_S) {
      told_s = known.shown.t;
      known.told = storedStatus(known.shown);
    }
  }
  if (past.until_s !== null && past.playing && past.at_s >= past.until_s) {
    past.until_s = null;
    setPlaying(false);
  }
  if (past.playing && !busy && past.at_s >= last_s && !windowed.some(({ t }) => t > played_s)) {
    if (last_s + 0.001 < end_s()) playFrom(last_s + 0.001, false);
    else goLive();
  }
}

// The status of a time of which nothing is stored.
function unknownStatus() {
  const nothing = { online: true, mode: null, power_w: null, late: null };
  const cameras = known.room.cameras.map((camera_id) => ({ camera_id, ...nothing }));
  return { cameras, people: null, latency_ms: [null, null], events: [] };
}

// The status of a stored slot: of what the store does not hold, null.
function storedStatus(slot) {
  const at_ns = 1e9 * slot.t, first = known.history[0], { row } = slot;
  const seeing = known.history.filter(({ blind }) => !blind), seconds = slot.t - first.t;
  const cameras = slot.cameras.map((name, index) => {
    const reading = readings.filter((one) => one.camera_id === name && one.run_id === row.run_id && one.time_ns <= at_ns).pop();
    const spent_w = row.energy_j && row.energy_j[index] !== null ? row.energy_j[index] * known.room.fps : null;
    const missing = slot.selected.has(name) && !slot.arrived.has(name);
    return {
      camera_id: name, online: true, mode: slot.selected.has(name) ? "active" : "power-saving",
      duty: seeing.length ? seeing.filter(({ selected }) => selected.has(name)).length / seeing.length : null,
      occlusion: row.occlusion[index], deficit: row.deficit[index], gain_nats: null, price: null,
      power_w: reading ? reading.energy_j / reading.span_s : spent_w, measured: Boolean(reading) && reading.source.startsWith("measured"),
      battery: reading ? reading.charge : null, temperature_c: null, late: null, why: missing ? "view missing" : "",
    };
  });
  const events = logged.filter(({ time_ns }) => time_ns <= at_ns).slice(-SHOWN_EVENTS);
  return {
    cameras, people: slot.people.length, expected_error_mm: null, lead: null, latency_ms: [null, null],
    fps: seconds > 0 ? (known.history.length - 1) / seconds : null,
    events: events.map((one) => one.message),
    events_ns: events.map((one) => one.time_ns),
  };
}
