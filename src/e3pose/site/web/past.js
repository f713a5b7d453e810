// The past on the live page: windows of the store, played by this page alone, and what was stored
// of cameras at that time in the place of their status.
"use strict";

const BEFORE_S = 60, SHOWN_EVENTS = 20, STATUS_S = 0.25; // seconds of a page between two tables
const GAP_S = 1, PRESENT_S = 5; // a longer gap between slots is skipped; so near the present is live

let span = null, windowed = [], at_s = 0, playing = false, loading = 0, readings = [], happened = [], told_s = 0;
let busy = false, opened = 0, played_s = 0; // slots up to here were shown

async function findSpan() {
  const runs = await ask("/api/runs");
  if (!runs.length) return;
  span = { begin_s: runs[0].started_ns / 1e9, runs: new Map(runs.map((run) => [run.run, run])) };
  byId("scrub").disabled = false;
}

const nanoseconds = (seconds) => `${Math.round(seconds * 1000)}000000`;
const end_s = () => Math.max(Date.now() / 1000 - 1, span.begin_s + 1);

async function load(from_s) {
  const asked = ++loading, range = `start=${nanoseconds(from_s)}&end=${nanoseconds(from_s + WINDOW_S)}`;
  const earlier = `start=${nanoseconds(from_s - BEFORE_S)}&end=${nanoseconds(from_s + WINDOW_S)}&limit=5000`;
  const [poses, rows, energy, events] = await Promise.all([
    ask(`/api/poses?limit=2000&${range}`), ask(`/api/slots?limit=5000&${range}`), ask(`/api/energy?${earlier}`), ask(`/api/events?${earlier}`),
  ]);
  if (asked !== loading) return;
  [readings, happened] = [energy.rows, events.rows];
  const people = new Map(poses.slots.map((slot) => [`${slot.run}.${slot.slot}`, slot.people]));
  windowed = rows.rows.map((row) => {
    const run = span.runs.get(row.run_id);
    const names = (flags) => (run ? run.cameras.filter((_, index) => flags[index] === "1") : []);
    const found = people.get(`${row.run_id}.${row.slot}`) || [];
    const slot = prepared({ slot: row.slot, time_ns: row.time_ns, people: found, blind: row.blind }, names(row.selected), names(row.arrived));
    return Object.assign(slot, { row, cameras: run ? run.cameras : [] });
  });
}

// Load what is stored from a time on. Where there is nothing, say so: a drag there shows nothing and
// waits; playing goes on at the next slot, or ends.
async function playFrom(from_s, dragged) {
  const asked = ++opened, current = () => mode === "past" && asked === opened;
  busy = true;
  try {
    await load(from_s);
    if (!current()) return;
    if (windowed.length) return notice("");
    const next = (await ask(`/api/slots?limit=1&start=${nanoseconds(from_s)}`)).rows[0];
    if (!current()) return;
    if (dragged) {
      setPlaying(false);
      notice(`No slot is stored at ${clock(from_s)}. ${next ? `The next one is of ${clock(next.time_ns / 1e9)}: play to go on there.` : "Nothing is stored after it."}`);
    } else if (next) {
      [at_s, played_s] = [next.time_ns / 1e9 - 0.002, -Infinity];
      await load(at_s);
      notice("");
    } else if (end_s() - from_s < PRESENT_S) {
      goLive();
    } else {
      setPlaying(false);
      notice(`Nothing is stored after ${clock(from_s)}.`);
    }
  } catch (error) {
    setPlaying(false);
    notice(error.message);
  } finally {
    if (asked === opened) busy = false;
  }
}

function setPlaying(on) {
  playing = on;
  byId("play").textContent = on ? "❚❚" : "▶";
  byId("play").setAttribute("aria-label", on ? "Pause" : "Play");
}

async function seek(to_s) {
  mode = "past";
  at_s = to_s;
  played_s = -Infinity;
  windowed = [];
  setPlaying(true);
  showNothing(to_s);
  showStatus(unknownStatus());
  byId("live").disabled = false;
  byId("play").hidden = false;
  showState();
  await playFrom(to_s, true);
}

function goLive() {
  mode = "live";
  playing = false;
  showNothing(null);
  byId("live").disabled = true;
  byId("play").hidden = true;
  byId("scrub").value = 1000;
  notice("");
  showState();
  if (status) showStatus(status);
}

function playPast(passed_s) {
  const next = windowed.find(({ t }) => t > played_s), last_s = windowed.length ? windowed[windowed.length - 1].t : at_s;
  at_s += playing && !busy ? passed_s : 0;
  if (playing && next && next.t - at_s > GAP_S) at_s = next.t;
  const due = windowed.filter(({ t }) => t > played_s && t <= at_s);
  due.forEach((slot, index) => (index === due.length - 1 ? show(slot) : remember(slot)));
  if (due.length) {
    played_s = shown.t;
    if (shown.t === last_s || Math.abs(shown.t - told_s) >= STATUS_S) {
      told_s = shown.t;
      showStatus(storedStatus(shown));
    }
  }
  if (playing && !busy && at_s >= last_s && !windowed.some(({ t }) => t > played_s)) {
    if (last_s + 0.001 < end_s()) playFrom(last_s + 0.001, false);
    else goLive();
  }
  if (document.activeElement !== byId("scrub")) byId("scrub").value = 1000 * (at_s - span.begin_s) / (end_s() - span.begin_s);
}

// The status of a time of which nothing is stored.
function unknownStatus() {
  const nothing = { online: true, mode: null, power_w: null, late: null };
  const cameras = room.cameras.map((camera_id) => ({ camera_id, ...nothing }));
  return { cameras, people: null, latency_ms: [null, null], events: [] };
}

// The status of a stored slot: of what the store does not hold, null.
function storedStatus(slot) {
  const at_ns = 1e9 * slot.t, first = history30[0], seeing = history30.filter(({ blind }) => !blind), seconds = slot.t - first.t, { row } = slot;
  const cameras = slot.cameras.map((name, index) => {
    const reading = readings.filter((one) => one.camera_id === name && one.run_id === row.run_id && one.time_ns <= at_ns).pop();
    const spent_w = row.energy_j && row.energy_j[index] !== null ? row.energy_j[index] * room.fps : null;
    const missing = slot.selected.has(name) && !slot.arrived.has(name);
    return {
      camera_id: name, online: true, mode: slot.selected.has(name) ? "active" : "power-saving",
      duty: seeing.length ? seeing.filter(({ selected }) => selected.has(name)).length / seeing.length : null,
      occlusion: row.occlusion[index], deficit: row.deficit[index], gain_nats: null, price: null,
      power_w: reading ? reading.energy_j / reading.span_s : spent_w, measured: Boolean(reading) && reading.source.startsWith("measured"),
      battery: reading ? reading.charge : null, temperature_c: null, late: null, why: missing ? "view missing" : "",
    };
  });
  const events = happened.filter(({ time_ns }) => time_ns <= at_ns).slice(-SHOWN_EVENTS);
  return {
    cameras, people: slot.people.length, expected_error_mm: null, lead: null, latency_ms: [null, null],
    fps: seconds > 0 ? (history30.length - 1) / seconds : null,
    events: events.map((one) => `${one.camera_id ? `${one.camera_id}: ` : ""}${one.message}`),
    events_ns: events.map((one) => one.time_ns),
  };
}
