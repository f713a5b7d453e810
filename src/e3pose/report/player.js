// The 3D player: skeletons and cameras drawn on a plain canvas, so that the page needs no WebGL and
// the scene can be turned while it plays. Units are millimetres, z is up.
"use strict";

const DATA = JSON.parse(document.getElementById("data").textContent);
// Told apart by people with any colour vision, on white (after Okabe and Ito, without yellow).
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#b38600", "#4d4d4d", "#8a4b16"];
const INK = "#1f2937", PALE = "#c3cad4", LOST_INK = "#b91c1c", TRUTH_INK = "#9aa3af";
const ASLEEP = 0, AWAKE = 1;
const NEAR = 100, MAX_LISTED = 14;
const byId = (id) => document.getElementById(id);
const colourOf = (track) => COLOURS[DATA.colours[track]];

const canvas = byId("scene"), pen = canvas.getContext("2d");
const last = DATA.slots.length - 1;
const centre = [0, 1, 2].map((axis) => (DATA.low[axis] + DATA.high[axis]) / 2);
const size = Math.max(...[0, 1, 2].map((axis) => DATA.high[axis] - DATA.low[axis]));
const eyeLevel = Math.max(DATA.low[2], Math.min(DATA.high[2], DATA.floor + 900));
const home = () => ({ yaw: -0.9, pitch: 0.42, distance: 1.1 * size, target: [centre[0], centre[1], eyeLevel] });

let view = home(), frame = DATA.start, playing = false, clock = 0, before = 0, stale = true;
const listeners = []; // called with the frame whenever it changes

function basis() {
  const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
  const back = [cp * cy, cp * sy, sp], right = [-sy, cy, 0], up = [-sp * cy, -sp * sy, cp];
  return { back, right, up, eye: view.target.map((t, axis) => t + view.distance * back[axis]) };
}

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

function projector() {
  const { back, right, up, eye } = basis();
  const width = canvas.clientWidth, height = canvas.clientHeight, focal = 1.1 * Math.min(width, 1.4 * height);
  return (x, y, z) => {
    const from = [x - eye[0], y - eye[1], z - eye[2]], depth = -dot(from, back);
    if (depth < NEAR) return null;
    return [width / 2 + (focal * dot(from, right)) / depth, height / 2 - (focal * dot(from, up)) / depth, depth];
  };
}

function draw() {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineCap = "round";
  const project = projector(), lines = [], labels = [];
  const line = (a, b, colour, thick) => {
    if (a && b) lines.push({ a, b, colour, thick, depth: (a[2] + b[2]) / 2 });
  };
  drawFloor(project);
  drawShadows(project);
  if (byId("truth") && byId("truth").checked) {
    for (const person of DATA.truth[frame] || []) addSkeleton(project, line, person, DATA.truthLimbs, TRUTH_INK, 2);
  }
  drawSureness(project);
  for (const [track, joints] of DATA.people[frame] || []) {
    const top = addSkeleton(project, line, joints, DATA.limbs, colourOf(track), 4.5);
    addNeck(project, line, joints, colourOf(track));
    if (top) labels.push([top[0], top[1] - 14, String(DATA.tracks[track]), colourOf(track), "600 14px"]);
  }
  DATA.frustums.forEach((points, camera) => addCamera(project, line, labels, points, camera));
  lines.sort((p, q) => q.depth - p.depth); // far lines first, near ones over them
  for (const { a, b, colour, thick } of lines) stroke(a, b, colour, thick);
  pen.textAlign = "center";
  for (const [x, y, text, colour, font] of labels) {
    pen.font = `${font} system-ui, sans-serif`;
    pen.lineWidth = 4;
    pen.strokeStyle = "#fff";
    pen.strokeText(text, x, y);
    pen.fillStyle = colour;
    pen.fillText(text, x, y);
  }
}

function stroke(a, b, colour, thick) {
  pen.strokeStyle = colour;
  pen.lineWidth = thick;
  pen.beginPath();
  pen.moveTo(a[0], a[1]);
  pen.lineTo(b[0], b[1]);
  pen.stroke();
}

// Metre squares; coarser where a scene is large.
function drawFloor(project) {
  const cell = 1000 * Math.max(1, Math.ceil(size / 30000));
  const [x0, y0] = [0, 1].map((axis) => Math.floor(DATA.low[axis] / cell) * cell);
  const [x1, y1] = [0, 1].map((axis) => Math.ceil(DATA.high[axis] / cell) * cell);
  const piece = (ax, ay, bx, by) => {
    const a = project(ax, ay, DATA.floor), b = project(bx, by, DATA.floor);
    if (a && b) stroke(a, b, "#e5e9ef", 1);
  };
  for (let x = x0; x <= x1; x += cell) for (let y = y0; y <= y1; y += cell) {
    if (x < x1) piece(x, y, x + cell, y);
    if (y < y1) piece(x, y, x, y + cell);
  }
}

// What a light from above would throw on the floor: shows where somebody stands.
function drawShadows(project) {
  for (const [, joints] of DATA.people[frame] || []) for (const [i, j] of DATA.limbs) {
    if (joints[3 * i] === null || joints[3 * j] === null) continue;
    const a = project(joints[3 * i], joints[3 * i + 1], DATA.floor);
    const b = project(joints[3 * j], joints[3 * j + 1], DATA.floor);
    if (a && b) stroke(a, b, "#dfe3e9", 4);
  }
}

// A disc around each joint that holds it in nine of ten cases: small where it is known well.
function drawSureness(project) {
  if (!byId("sure") || !byId("sure").checked) return;
  const focal = 1.1 * Math.min(canvas.clientWidth, 1.4 * canvas.clientHeight);
  pen.globalAlpha = 0.16;
  for (const [track, joints, radii] of DATA.people[frame] || []) {
    pen.fillStyle = colourOf(track);
    for (let i = 0; radii && i < radii.length; i++) {
      if (radii[i] === null || joints[3 * i] === null) continue;
      const p = project(joints[3 * i], joints[3 * i + 1], joints[3 * i + 2]);
      if (!p) continue;
      pen.beginPath();
      pen.arc(p[0], p[1], Math.min(Math.max((focal * radii[i]) / p[2], 1.5), 200), 0, 2 * Math.PI);
      pen.fill();
    }
  }
  pen.globalAlpha = 1;
}

function addSkeleton(project, line, joints, limbs, colour, thick) {
  const pixels = [];
  for (let i = 0; i < joints.length; i += 3) {
    pixels.push(joints[i] === null ? null : project(joints[i], joints[i + 1], joints[i + 2]));
  }
  for (const [i, j] of limbs) line(pixels[i], pixels[j], colour, thick);
  return pixels.reduce((top, p) => (p && (!top || p[1] < top[1]) ? p : top), null);
}

// From between the shoulders to the nose, for skeletons that have no neck.
function addNeck(project, line, joints, colour) {
  const at = (joint, axis) => joints[3 * joint + axis];
  if (!DATA.neck.length || DATA.neck.some((joint) => at(joint, 0) === null)) return;
  const [nose, left, right] = DATA.neck;
  const middle = [0, 1, 2].map((axis) => (at(left, axis) + at(right, axis)) / 2);
  line(project(...middle), project(at(nose, 0), at(nose, 1), at(nose, 2)), colour, 4.5);
}

function addCamera(project, line, labels, points, camera) {
  const state = DATA.states[camera][frame] ?? ASLEEP; // there may be no slot at all
  const [colour, thick] = state === AWAKE ? [INK, 2.5] : state === ASLEEP ? [PALE, 1.2] : [LOST_INK, 2.5];
  const pixels = [0, 1, 2, 3, 4].map((i) => project(points[3 * i], points[3 * i + 1], points[3 * i + 2]));
  for (let corner = 1; corner <= 4; corner++) {
    line(pixels[0], pixels[corner], colour, thick);
    line(pixels[corner], pixels[(corner % 4) + 1], colour, thick);
  }
  if (pixels[0]) {
    const weight = state === ASLEEP ? "400 12px" : "700 12px";
    labels.push([pixels[0][0], pixels[0][1] - 10, DATA.cameras[camera], state === ASLEEP ? "#8a93a1" : colour, weight]);
  }
}

// ---- playing

function seek(index) {
  frame = Math.max(0, Math.min(last, index));
  clock = DATA.times[frame];
  byId("scrub").value = frame;
  byId("where").textContent = `slot ${DATA.slots[frame]} · ${DATA.times[frame].toFixed(2)} s`;
  showPeople();
  showReasons();
  stale = true;
  for (const listener of listeners) listener(frame);
}

function showPeople() {
  const list = byId("people");
  list.replaceChildren();
  const tracks = (DATA.people[frame] || []).map(([track]) => track).sort((a, b) => DATA.tracks[a] - DATA.tracks[b]);
  for (const track of tracks.slice(0, MAX_LISTED)) {
    const item = document.createElement("li"), swatch = document.createElement("i");
    swatch.style.background = colourOf(track);
    item.append(swatch, `track ${DATA.tracks[track]}`);
    list.append(item);
  }
  if (!tracks.length) list.append("no people");
  if (tracks.length > MAX_LISTED) list.append(`and ${tracks.length - MAX_LISTED} more`);
  const awake = DATA.cameras.filter((_, camera) => DATA.states[camera][frame] === AWAKE);
  byId("awake").textContent = awake.length ? awake.join(", ") : "none";
}

// Why the cameras of this slot were chosen: what each tells beyond the others, what its queue asks.
function showReasons() {
  if (!DATA.gain) return;
  const order = DATA.cameras.map((_, camera) => camera);
  order.sort((a, b) => (DATA.gain[b][frame] ?? 0) - (DATA.gain[a][frame] ?? 0));
  const digits = (value, places) => (value === null ? "–" : value.toFixed(places));
  byId("why").tBodies[0].replaceChildren(...order.slice(0, MAX_LISTED).map((camera) => {
    const row = document.createElement("tr");
    row.className = DATA.states[camera][frame] === ASLEEP ? "" : "on";
    const cells = [DATA.cameras[camera], digits(DATA.gain[camera][frame], 2), digits(DATA.price[camera][frame], 1)];
    for (const text of cells) row.insertCell().append(text);
    return row;
  }));
  const expected = DATA.expected[frame];
  byId("expected").textContent = expected === null ? "" : `expected error: ${expected} mm`;
}

function play(on) {
  if (on && frame === last) seek(0);
  playing = on && last > 0;
  byId("play").textContent = playing ? "❚❚ Pause" : "▶ Play";
}

function tick(now) {
  if (playing) {
    clock += ((now - before) / 1000) * Number(byId("speed").value);
    let next = frame;
    while (next < last && DATA.times[next + 1] <= clock) next++;
    const reached = clock;
    if (next !== frame) seek(next);
    clock = reached;
    if (frame === last) seek(0); // play on from the beginning
  }
  before = now;
  if (stale) draw();
  stale = false;
  requestAnimationFrame(tick);
}

// ---- turning

function move(event, dx, dy) {
  if (event.shiftKey || event.buttons === 2) {
    const { right, up } = basis(), scale = view.distance / canvas.clientHeight;
    view.target = view.target.map((t, axis) => t + scale * (dy * up[axis] - dx * right[axis]));
  } else {
    view.yaw -= dx * 0.008;
    view.pitch = Math.max(-0.2, Math.min(1.55, view.pitch + dy * 0.008));
  }
  stale = true;
}

canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
canvas.addEventListener("pointermove", (event) => event.buttons && move(event, event.movementX, event.movementY));
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("dblclick", () => ((view = home()), (stale = true)));
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  const wanted = view.distance * Math.exp(event.deltaY * 0.001);
  view.distance = Math.max(0.1 * size, Math.min(5 * size, wanted));
  stale = true;
}, { passive: false });
byId("play").addEventListener("click", () => play(!playing));
byId("scrub").addEventListener("input", () => seek(Number(byId("scrub").value)));
for (const box of ["truth", "sure"]) if (byId(box)) byId(box).addEventListener("change", () => (stale = true));
window.addEventListener("resize", () => (stale = true));
document.addEventListener("keydown", (event) => {
  if (["SELECT", "INPUT", "BUTTON"].includes(event.target.tagName)) return;
  const action = { " ": () => play(!playing), ArrowRight: () => seek(frame + 1), ArrowLeft: () => seek(frame - 1) }[event.key];
  if (action) event.preventDefault(), action();
});

byId("scrub").max = Math.max(last, 0);
if (last >= 0) seek(DATA.start);
requestAnimationFrame(tick);
