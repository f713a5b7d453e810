// The time line: a clock, what is stored, blind slots, who was there, marks of what people did. Drag
// or arrow keys go into the past; + and - change the stretch of time that it shows.
import { html, useEffect, useLayoutEffect, useRef, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { ALARMS, occurrences, sentence } from "./happened.js";
import { changed, known } from "./known.js";
import { colourOf, learnNames, ofRow, whoIs } from "./names.js";
import { hatching, inks, penOf } from "./palette.js";
import { end_s, goLive, past, seek, setPlaying } from "./past.js";
import { clock, duration, nanoseconds, number } from "./words.js";

const SPANS = [60, 600, 3600, 6 * 3600, 86_400, 7 * 86_400]; // seconds that can be shown
const SPAN_WORDS = ["1 min", "10 min", "1 h", "6 h", "1 day", "1 week"];
const PARTS = 200, FRESH_MS = 10_000, ALL_AGAIN_MS = 600_000, MOST_ROWS = 5000;
const LONGEST_S = 8 * 86_400, LATE_S = 30; // that can be asked for at once; that the store may be behind
const HEIGHT = 76, LANES = { people: 20, seen: 38, marks: 54 }, LANE = 12;
const STEPS = [5, 10, 30, 60, 300, 600, 1800, 3600, 3 * 3600, 6 * 3600, 86_400];

export const line = { zoom: 1, known: covered(1), asking: false, again: false, marked: null };

// The stretch of time shown: up to now while live; around the moment shown else.
export function stretch() {
  const span_s = SPANS[line.zoom], live_s = known.mode === "live" && known.shown ? known.shown.t : Date.now() / 1000;
  const now_s = Math.max(live_s, Date.now() / 1000 - 1);
  const until_s = known.mode === "past" ? Math.min(now_s, past.at_s + span_s / 2) : now_s;
  return { from_s: until_s - span_s, until_s, span_s };
}

// What is known of the store, in parts as wide as the zoom has them. Parts that are over are asked for once.
function covered(zoom) {
  return { zoom, part_s: SPANS[zoom] / PARTS, parts: new Map(), over: new Set(), tracks: new Map(), from_s: Infinity, to_s: -Infinity, since_ms: performance.now() };
}

// Which tracks to ask for: those of a stretch, less what joins it and is known.
function missing(have, begin_s, end_s) {
  if (begin_s > have.to_s || end_s < have.from_s) return [begin_s, end_s];
  return [begin_s < have.from_s ? begin_s : have.to_s - LATE_S, end_s > have.to_s ? end_s : have.from_s];
}

// Ask for what the store has of the stretch and a quarter around it, less what is known.
export async function look() {
  if (!past.span || document.hidden) return;
  if (line.asking) return void (line.again = true); // what is shown has changed meanwhile
  if (line.known.zoom !== line.zoom || performance.now() - line.known.since_ms > ALL_AGAIN_MS) line.known = covered(line.zoom);
  const { known: have } = line, { part_s, over } = have, { from_s, until_s, span_s } = stretch(), now_s = Date.now() / 1000;
  const around_s = Math.min(span_s / 4, (LONGEST_S - span_s) / 2 - part_s), end_s = Math.min(until_s + around_s, now_s), begin_s = Math.max(Math.min(from_s - around_s, end_s - part_s), 0);
  let [first, last] = [Math.floor(begin_s / part_s), Math.ceil(end_s / part_s)];
  while (first < last && over.has(first)) first++;
  while (last > first && over.has(last - 1)) last--;
  const [low_s, high_s] = missing(have, begin_s, end_s);
  line.asking = true;
  try {
    const [found, tracks] = await Promise.all([
      first < last ? ask(`/api/timeline?start=${nanoseconds(first * part_s)}&end=${nanoseconds(last * part_s)}&parts=${last - first}`) : { slots: [], blind: [] },
      low_s < high_s ? ask(`/api/tracks?start=${nanoseconds(low_s)}&end=${nanoseconds(high_s)}&limit=${MOST_ROWS}`) : { rows: [] },
    ]);
    found.slots.forEach((slots, index) => {
      have.parts.set(first + index, [slots, found.blind[index]]);
      if ((first + index + 1) * part_s < now_s - LATE_S) over.add(first + index);
    });
    const whole = low_s === begin_s && high_s === end_s;
    if (whole) have.tracks.clear();
    for (const row of tracks.rows) have.tracks.set(`${row.run_id} ${row.track_id}`, row);
    [have.from_s, have.to_s] = whole ? [begin_s, end_s] : [Math.min(have.from_s, begin_s), Math.max(have.to_s, end_s)];
    learnNames(tracks.rows.map(ofRow));
  } catch {
    line.known = covered(line.zoom); // the next look tries again
  } finally {
    line.asking = false;
    if (line.again) {
      line.again = false;
      look();
    }
  }
}

const parts = (canvas) => {
  const { from_s, until_s, span_s } = stretch(), width = canvas.clientWidth;
  return { from_s, until_s, span_s, width, x: (t) => ((t - from_s) / span_s) * width, t: (x) => from_s + (x / width) * span_s };
};

function tickWords(t, step_s) {
  const when = new Date(1000 * t);
  if (step_s >= 86_400) return when.toLocaleDateString([], { weekday: "short", day: "numeric" });
  return when.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", ...(step_s < 60 ? { second: "2-digit" } : {}) });
}

function drawClock(pen, { from_s, until_s, span_s, width, x }, ink) {
  const step_s = STEPS.find((one) => (one / span_s) * width > (one < 60 ? 84 : 62)) || 86_400;
  const shift = new Date(1000 * from_s).getTimezoneOffset() * 60; // ticks stand at round local times
  pen.fillStyle = ink.soft;
  for (let t = Math.ceil((from_s - shift) / step_s) * step_s + shift; t <= until_s; t += step_s) {
    pen.fillStyle = ink.line;
    pen.fillRect(Math.round(x(t)), 14, 1, HEIGHT - 14);
    const words = tickWords(t, step_s), half = pen.measureText(words).width / 2;
    if (x(t) - half < 0 || x(t) + half > width) continue;
    pen.fillStyle = ink.soft;
    pen.fillText(words, x(t) - half, 8);
  }
}

function drawStored(pen, { x, width }, ink) {
  pen.fillStyle = hatching(pen);
  pen.fillRect(0, LANES.seen, width, LANE);
  const { part_s, parts } = line.known;
  for (const [part, [slots, unseen]] of parts) {
    const from = x(part * part_s), wide = x((part + 1) * part_s) - from;
    if (!slots || from > width || from + wide < 0) continue;
    pen.fillStyle = ink.stored;
    pen.fillRect(from, LANES.seen, wide + 0.5, LANE);
    if (!unseen) continue;
    pen.fillStyle = ink.blind; // a single blind slot can be seen as well
    const high = Math.max(3, (LANE * unseen) / slots);
    pen.fillRect(from, LANES.seen + LANE - high, Math.max(wide, 1.5), high);
  }
  for (const slot of known.mode === "live" ? known.history : []) { // what is too new to be asked for
    pen.fillStyle = slot.blind ? ink.blind : ink.stored;
    pen.fillRect(x(slot.t - 1 / known.room.slots_per_s), LANES.seen, Math.max(x(slot.t) - x(slot.t - 1 / known.room.slots_per_s), 0.7), LANE);
  }
}

// When whom was there: lines in their colours, beside each other.
function drawPeople(pen, { x }) {
  const rows = [...line.known.tracks.values()].map((row) => [row.first_ns / 1e9, row.last_ns / 1e9, row.track_id, row.run_id]);
  if (known.mode === "live" && known.shown) for (const { track, does } of known.shown.people) if (does.since_ns) rows.push([does.since_ns / 1e9, known.shown.t, track, known.run]);
  const busy = []; // until when each lane is taken
  for (const [from, to, track, run] of rows.sort((a, b) => a[0] - b[0])) {
    const who = whoIs(track, run);
    let lane = busy.findIndex(([one, until]) => one === who || until < from);
    if (lane < 0) lane = busy.length;
    busy[lane] = [who, to];
    pen.fillStyle = colourOf(track, run);
    pen.fillRect(x(from), LANES.people + 3 * Math.min(lane, 4), Math.max(x(to) - x(from), 1.5), 2);
  }
}

function drawMarks(pen, { x, from_s, until_s }, ink) {
  for (const one of occurrences()) {
    if (one.start_s < from_s || one.start_s > until_s) continue;
    const alarm = ALARMS.has(one.kind), at = x(one.start_s), r = alarm ? 6 : 4, y = LANES.marks + 9;
    pen.fillStyle = alarm ? ink.alarm : ink.mark;
    pen.strokeStyle = ink.paper;
    pen.beginPath();
    for (const [dx, dy] of [[0, -r], [r, 0], [0, r], [-r, 0]]) pen.lineTo(at + dx, y + dy);
    pen.closePath();
    pen.fill();
    pen.stroke();
  }
}

// Clips as thin bars; what is marked as a band.
function drawKept(pen, { x, width }, ink) {
  pen.fillStyle = ink.mark;
  for (const { from_s, to_s } of known.clips) if (x(to_s) >= 0 && x(from_s) <= width) pen.fillRect(x(from_s), HEIGHT - 3, Math.max(x(to_s) - x(from_s), 2), 3);
  if (!line.marked || known.tab !== "keep") return;
  const [from, to] = [x(line.marked.from_s), x(line.marked.to_s)];
  pen.globalAlpha = 0.18;
  pen.fillRect(from, 14, Math.max(to - from, 1), HEIGHT - 14);
  pen.globalAlpha = 1;
  for (const at of [from, to]) pen.fillRect(Math.round(at) - 1, 14, 2, HEIGHT - 14);
}

function draw(canvas) {
  const ink = inks(), pen = penOf(canvas, HEIGHT), at = parts(canvas);
  drawClock(pen, at, ink);
  drawStored(pen, at, ink);
  drawPeople(pen, at);
  drawMarks(pen, at, ink);
  drawKept(pen, at, ink);
  const t = known.mode === "past" ? known.shown?.t ?? past.at_s : at.until_s;
  pen.fillStyle = ink.cursor;
  pen.fillRect(Math.min(Math.max(x0(at.x(t)), 0), at.width - 2), 14, 2, HEIGHT - 14);
}
const x0 = (x) => Math.round(x) - 1;

// What is under the pointer: a mark in its sentence, else the time.
function under(canvas, event) {
  const at = parts(canvas), t = at.t(event.offsetX);
  const near = occurrences().filter((one) => Math.abs(at.x(one.start_s) - event.offsetX) < 7 && event.offsetY > LANES.marks - 4).at(-1);
  return { t: near ? near.start_s - 3 : t, words: near ? sentence(near) : clock(t) };
}

const goTo = (t) => (t >= end_s() - 1 ? goLive() : seek(Math.max(t, past.span.begin_s)));
// Show a stretch whole.
export function zoomOver(from_s, to_s) {
  const fits = SPANS.findIndex((span_s) => span_s > 1.5 * (to_s - from_s));
  zoomTo(fits < 0 ? SPANS.length - 1 : fits);
}

const zoomTo = (zoom) => ((line.zoom = Math.max(0, Math.min(SPANS.length - 1, zoom))), look(), changed());

function byKey(event) {
  const { span_s } = stretch(), at_s = known.mode === "past" ? past.at_s : end_s();
  const by = { ArrowLeft: -span_s / 60, ArrowRight: span_s / 60, PageUp: -span_s / 6, PageDown: span_s / 6 }[event.key];
  const [begins_s, ends_s] = [line.marked?.from_s ?? at_s - 10, line.marked?.to_s ?? at_s + 10];
  if (known.tab === "keep" && event.key === "[") line.marked = { from_s: at_s, to_s: Math.max(ends_s, at_s + 1) };
  if (known.tab === "keep" && event.key === "]") line.marked = { from_s: Math.min(begins_s, at_s - 1), to_s: at_s };
  if ("[]".includes(event.key)) return changed();
  const other = { Home: () => goTo(past.span.begin_s), End: goLive, "+": () => zoomTo(line.zoom - 1), "=": () => zoomTo(line.zoom - 1), "-": () => zoomTo(line.zoom + 1) }[event.key];
  if (by === undefined && !other) return;
  event.preventDefault();
  if (other) other();
  else if (by < 0 || known.mode === "past") goTo(at_s + by);
}

function whereWords() {
  const { shown, mode } = known;
  if (!shown) return mode === "past" ? `${clock(past.at_s)} · nothing stored` : "";
  return `${clock(shown.t)}${shown.late_ms === null ? "" : ` · smoothed, published after ${number(shown.late_ms)} ms`}`;
}

export function Timeline() {
  const canvas = useRef(null), dragged = useRef(null), [said, say] = useState("");
  useEffect(() => {
    const timer = setInterval(look, FRESH_MS);
    new ResizeObserver(changed).observe(canvas.current);
    return () => clearInterval(timer);
  }, []);
  useLayoutEffect(() => draw(canvas.current));
  useEffect(() => void look(), [line.zoom, known.mode, Boolean(past.span), Math.round((4 * past.at_s) / SPANS[line.zoom])]);
  const { from_s, until_s } = stretch(), at_s = known.mode === "past" ? past.at_s : until_s, open = Boolean(past.span);
  const down = (event) => open && (canvas.current.setPointerCapture(event.pointerId), (dragged.current = { ...under(canvas.current, event), x: event.offsetX, marks: false }));
  const moved = (event) => {
    const found = under(canvas.current, event);
    say(found.words);
    const from = dragged.current;
    if (!from) return;
    const marks = from.marks || (known.tab === "keep" && Math.abs(event.offsetX - from.x) > 4), at = parts(canvas.current);
    if (marks) line.marked = { from_s: at.t(Math.min(from.x, event.offsetX)), to_s: at.t(Math.max(from.x, event.offsetX)) };
    dragged.current = { ...found, x: from.x, marks };
    changed();
  };
  const up = () => {
    const let_go = dragged.current;
    dragged.current = null;
    if (let_go) let_go.marks ? changed() : goTo(let_go.t);
  };
  return html`<section id="line-box" aria-label="Time line">
    <div id="bar">
      <button id="live" type="button" disabled=${known.mode === "live"} onClick=${goLive}>● Live</button>
      <button id="play" type="button" hidden=${known.mode === "live"} aria-label=${past.playing ? "Pause" : "Play"} onClick=${() => setPlaying(!past.playing)}>${past.playing ? "❚❚" : "▶"}</button>
      <span id="where" class="clock">${whereWords()}</span>
      <span class="soft" id="pointed">${said}</span>
      <span class="zoom"><button type="button" aria-label="Show less time" disabled=${line.zoom === 0} onClick=${() => zoomTo(line.zoom - 1)}>+</button>
      <span id="span">${SPAN_WORDS[line.zoom]}</span>
      <button type="button" aria-label="Show more time" disabled=${line.zoom === SPANS.length - 1} onClick=${() => zoomTo(line.zoom + 1)}>−</button></span>
    </div>
    <canvas id="line" ref=${canvas} style=${{ height: `${HEIGHT}px` }} tabindex=${open ? 0 : -1} role="slider" aria-label="Time: arrow keys go into the past, Home to the first, End to now" aria-disabled=${!open}
      aria-valuemin=${Math.round(from_s)} aria-valuemax=${Math.round(until_s)} aria-valuenow=${Math.round(Math.min(Math.max(at_s, from_s), until_s))} aria-valuetext=${known.mode === "live" ? "now" : clock(at_s)}
      onPointerDown=${down} onPointerMove=${moved} onPointerUp=${up} onPointerLeave=${() => say("")} onKeyDown=${(event) => open && byKey(event)}></canvas>
    <details class="help"><summary>What the line shows</summary><p>From above: the time of day; who was there, in their colours; stored time, amber where it was blind (no view came although one was due), hatched where nothing is stored; what happened, red where it is grave. ${open ? `Drag, click a mark, or use the arrow keys; + and − change the stretch. ${known.tab === "keep" ? "Drag to mark, click to go there, [ and ] mark from and to the moment shown." : ""} Space: pause. It reaches back ${duration(end_s() - past.span.begin_s)}.` : "This site stores nothing yet, so there is no past to open."}</p></details>
  </section>`;
}
