// People and cameras in 3D on a plain canvas, which needs no WebGL; the report and the live page
// draw with it. Units are millimetres, z is up.
"use strict";

// Distinct with any colour vision, on white (after Okabe and Ito, without yellow).
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#b38600", "#4d4d4d", "#8a4b16"];
const INK = "#1f2937", PALE = "#c3cad4", LOST_INK = "#b91c1c", TRUTH_INK = "#9aa3af", SLEEP_INK = "#9fb4d6", BLIND_INK = "#d97706";
const ASLEEP = 0, AWAKE = 1, LOST = 2, DEEP = 3, BLIND = 4, UNKNOWN = 5; // saving, active, lost, not capturing, blind slot, not known
// What a scene is drawn with, on a light and on a dark page; COLOURS are of the light one.
const LIGHT = {
  colours: COLOURS, paper: "#fff", grid: "#e5e9ef", wall: "#dfe3e9", wallFill: "rgba(31, 41, 55, 0.025)", zone: "rgba(31, 41, 55, 0.05)",
  entered: "rgba(0, 158, 115, 0.16)", zoneEdge: TRUTH_INK, soft: "#5f6876", truth: TRUTH_INK, disc: 0.16,
  cameras: [PALE, INK, LOST_INK, SLEEP_INK, BLIND_INK, "#e3e7ed"],
};
const DARK = {
  colours: ["#58b0e8", "#f59458", "#35c9a0", "#e7a3cb", "#a5dbf7", "#dcb73f", "#c4c4c4", "#d09a6c"], paper: "#14181f",
  grid: "#262d38", wall: "#2d3542", wallFill: "rgba(226, 232, 240, 0.025)", zone: "rgba(226, 232, 240, 0.06)",
  entered: "rgba(53, 201, 160, 0.22)", zoneEdge: "#6b7688", soft: "#a3adbb", truth: "#717c8c", disc: 0.26,
  cameras: ["#4a5466", "#e2e8f0", "#f87171", "#56709c", "#f5a623", "#2a313d"],
};
const NEAR = 100;
const byId = (id) => document.getElementById(id);

// Draws on a canvas and lets people turn what is drawn.
//   room: limbs, neck, frustums (of 5 points), cameras (names), low, high, floor; truthLimbs, zones.
//   what: returns what to draw now: people [{ colour, label, joints, radii, trail }], states (a code
//     for each camera), truth [joints], inks (LIGHT by default), limbs and neck (those of the room
//     by default).
// Returns { draw, touch, reset }: draw if something changed, say that something did, look as at first.
function makeScene(canvas, room, what) {
  const pen = canvas.getContext("2d");
  const centre = [0, 1, 2].map((axis) => (room.low[axis] + room.high[axis]) / 2);
  const size = Math.max(...[0, 1, 2].map((axis) => room.high[axis] - room.low[axis]));
  const eyeLevel = Math.max(room.low[2], Math.min(room.high[2], room.floor + 900));
  let view = null, stale = true, project = null, inks = LIGHT;
  let fitted = null; // width and height that the view was fitted to; null once people turned it

  // The view at first: as near as all cameras with their names fit into the canvas.
  function home() {
    fitted = [canvas.clientWidth, canvas.clientHeight];
    view = { yaw: -0.9, pitch: 0.42, distance: 0, target: [centre[0], centre[1], eyeLevel] };
    const { back, right, up } = basis(), focal = focalLength();
    const name = 3.6 * Math.max(0, ...room.cameras.map((text) => text.length)); // half of its pixels
    const across = Math.max(fitted[0] / 2 - name - 10, 60), above = Math.max(fitted[1] / 2 - 30, 60);
    view.distance = room.frustums.length ? 0.6 * size : 1.1 * size;
    for (const points of room.frustums) for (let i = 0; i < points.length; i += 3) {
      const from = [0, 1, 2].map((axis) => points[i + axis] - view.target[axis]);
      const wide = Math.max(Math.abs(dot(from, right)) / across, Math.abs(dot(from, up)) / above);
      view.distance = Math.max(view.distance, dot(from, back) + focal * wide);
    }
  }

  function basis() {
    const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
    const back = [cp * cy, cp * sy, sp], right = [-sy, cy, 0], up = [-sp * cy, -sp * sy, cp];
    return { back, right, up, eye: view.target.map((t, axis) => t + view.distance * back[axis]) };
  }

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const focalLength = () => 1.1 * Math.min(canvas.clientWidth, 1.4 * canvas.clientHeight);

  function projector() {
    const { back, right, up, eye } = basis();
    const width = canvas.clientWidth, height = canvas.clientHeight, focal = focalLength();
    return (x, y, z) => {
      const from = [x - eye[0], y - eye[1], z - eye[2]], depth = -dot(from, back);
      if (depth < NEAR) return null;
      return [width / 2 + (focal * dot(from, right)) / depth, height / 2 - (focal * dot(from, up)) / depth, depth];
    };
  }

  function draw() {
    if (!stale) return;
    stale = false;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!view || (fitted && (fitted[0] !== width || fitted[1] !== height))) home();
    if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
    if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    pen.lineCap = "round";
    project = projector();
    const shown = what(), lines = [], labels = [], { limbs = room.limbs, neck = room.neck } = shown;
    inks = shown.inks || LIGHT;
    const line = (a, b, colour, thick) => {
      if (a && b) lines.push({ a, b, colour, thick, depth: (a[2] + b[2]) / 2 });
    };
    drawFloor();
    drawWalls();
    (room.zones || []).forEach((zone) => drawZone(zone, labels));
    drawShadows(shown.people, limbs);
    for (const joints of shown.truth || []) addSkeleton(line, joints, room.truthLimbs, inks.truth, 2);
    drawSureness(shown.people);
    for (const { colour, label, joints, trail } of shown.people) {
      drawTrail(trail || [], colour);
      const top = addSkeleton(line, joints, limbs, colour, 4.5);
      addNeck(line, joints, neck, colour);
      if (top) labels.push([top[0], top[1] - 14, label, colour, "600 14px"]);
    }
    room.frustums.forEach((points, camera) => addCamera(line, labels, points, room.cameras[camera], shown.states[camera]));
    lines.sort((p, q) => q.depth - p.depth); // far lines first, near ones over them
    for (const { a, b, colour, thick } of lines) stroke(a, b, colour, thick);
    pen.textAlign = "center";
    for (const [x, y, text, colour, font] of labels) {
      pen.font = `${font} system-ui, sans-serif`;
      const half = pen.measureText(text).width / 2, seen = x > -half && x < width + half;
      const at = seen ? Math.max(half + 2, Math.min(width - half - 2, x)) : x; // whole while it is in sight
      pen.lineWidth = 4;
      pen.strokeStyle = inks.paper;
      pen.strokeText(text, at, y);
      pen.fillStyle = colour;
      pen.fillText(text, at, y);
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
  function drawFloor() {
    const cell = 1000 * Math.max(1, Math.ceil(size / 30000));
    const [x0, y0] = [0, 1].map((axis) => Math.floor(room.low[axis] / cell) * cell);
    const [x1, y1] = [0, 1].map((axis) => Math.ceil(room.high[axis] / cell) * cell);
    const piece = (ax, ay, bx, by) => {
      const a = project(ax, ay, room.floor), b = project(bx, by, room.floor);
      if (a && b) stroke(a, b, inks.grid, 1);
    };
    for (let x = x0; x <= x1; x += cell) for (let y = y0; y <= y1; y += cell) {
      if (x < x1) piece(x, y, x + cell, y);
      if (y < y1) piece(x, y, x, y + cell);
    }
  }

  // The walls behind the scene, around what the cameras stand in: those in front would hide it.
  function drawWalls() {
    const { eye } = basis(), [x0, y0] = room.low, [x1, y1, top] = room.high;
    const walls = [[x0, y0, x0, y1, eye[0] > x0], [x1, y0, x1, y1, eye[0] < x1], [x0, y0, x1, y0, eye[1] > y0], [x0, y1, x1, y1, eye[1] < y1]];
    for (const [ax, ay, bx, by, behind] of walls) {
      const corners = [[ax, ay, room.floor], [bx, by, room.floor], [bx, by, top], [ax, ay, top]].map((corner) => project(...corner));
      if (!behind || corners.some((corner) => !corner)) continue;
      pen.beginPath();
      corners.forEach(([x, y], index) => (index ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      pen.closePath();
      pen.fillStyle = inks.wallFill;
      pen.fill();
      pen.strokeStyle = inks.wall;
      pen.lineWidth = 1;
      pen.stroke();
    }
  }

  function drawZone(zone, labels) {
    const corners = zone.corners.map(([x, y]) => project(1000 * x, 1000 * y, room.floor));
    if (corners.some((corner) => !corner)) return;
    pen.beginPath();
    corners.forEach(([x, y], index) => (index ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.closePath();
    pen.fillStyle = zone.count ? inks.entered : inks.zone;
    pen.fill();
    pen.strokeStyle = inks.zoneEdge;
    pen.lineWidth = 1;
    pen.stroke();
    const middle = [0, 1].map((axis) => corners.reduce((sum, corner) => sum + corner[axis], 0) / corners.length);
    labels.push([middle[0], middle[1], zone.count ? `${zone.name}: ${zone.count}` : zone.name, inks.soft, "400 12px"]);
  }

  // What a light from above would throw on the floor: shows where somebody stands.
  function drawShadows(people, limbs) {
    for (const { joints } of people) for (const [i, j] of limbs) {
      if (joints[3 * i] === null || joints[3 * j] === null) continue;
      const a = project(joints[3 * i], joints[3 * i + 1], room.floor);
      const b = project(joints[3 * j], joints[3 * j + 1], room.floor);
      if (a && b) stroke(a, b, inks.wall, 4);
    }
  }

  // Where somebody stood before: [x, y], oldest first.
  function drawTrail(trail, colour) {
    for (let i = 1; i < trail.length; i++) {
      const a = project(...trail[i - 1], room.floor), b = project(...trail[i], room.floor);
      pen.globalAlpha = 0.6 * (i / trail.length);
      if (a && b) stroke(a, b, colour, 2);
    }
    pen.globalAlpha = 1;
  }

  // A disc around each joint that holds it in nine of ten cases: small where it is known well.
  function drawSureness(people) {
    const focal = focalLength();
    pen.globalAlpha = inks.disc;
    for (const { colour, joints, radii } of people) {
      pen.fillStyle = colour;
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

  function addSkeleton(line, joints, limbs, colour, thick) {
    const pixels = [];
    for (let i = 0; i < joints.length; i += 3) {
      pixels.push(joints[i] === null ? null : project(joints[i], joints[i + 1], joints[i + 2]));
    }
    for (const [i, j] of limbs) line(pixels[i], pixels[j], colour, thick);
    return pixels.reduce((top, p) => (p && (!top || p[1] < top[1]) ? p : top), null);
  }

  // From between the shoulders to the nose, for skeletons that have no neck.
  function addNeck(line, joints, neck, colour) {
    const at = (joint, axis) => joints[3 * joint + axis];
    if (!neck.length || neck.some((joint) => at(joint, 0) === null)) return;
    const [nose, left, right] = neck;
    const middle = [0, 1, 2].map((axis) => (at(left, axis) + at(right, axis)) / 2);
    line(project(...middle), project(at(nose, 0), at(nose, 1), at(nose, 2)), colour, 4.5);
  }

  function addCamera(line, labels, points, name, state = ASLEEP) {
    const [colour, thick] = [inks.cameras[state], [1.2, 2.5, 2.5, 1.2, 2.5, 0.8][state]];
    const pixels = [0, 1, 2, 3, 4].map((i) => project(points[3 * i], points[3 * i + 1], points[3 * i + 2]));
    for (let corner = 1; corner <= 4; corner++) {
      line(pixels[0], pixels[corner], colour, thick);
      line(pixels[corner], pixels[(corner % 4) + 1], colour, thick);
    }
    if (pixels[0]) {
      const quiet = [ASLEEP, DEEP, UNKNOWN].includes(state);
      labels.push([pixels[0][0], pixels[0][1] - 10, name, quiet ? inks.soft : colour, quiet ? "400 12px" : "700 12px"]);
    }
  }

  // ---- turning

  const fingers = new Map(); // pointers that are down, by their ids
  const touch = () => (stale = true);
  const zoom = (factor) => {
    fitted = null;
    view.distance = Math.max(0.1 * size, Math.min(5 * size, view.distance * factor));
    touch();
  };

  function pan(dx, dy) {
    fitted = null;
    const { right, up } = basis(), scale = view.distance / canvas.clientHeight;
    view.target = view.target.map((t, axis) => t + scale * (dy * up[axis] - dx * right[axis]));
  }

  function move(event) {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    const others = [...fingers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (others.length === 1) {
      const apart = ([x, y]) => Math.hypot(x - others[0][0], y - others[0][1]);
      zoom(apart(before) / Math.max(apart([event.clientX, event.clientY]), 1));
      pan(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2) {
      pan(dx, dy);
    } else {
      fitted = null;
      view.yaw -= dx * 0.008;
      view.pitch = Math.max(-0.2, Math.min(1.55, view.pitch + dy * 0.008));
    }
    touch();
  }

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", move);
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => (home(), touch()));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY * 0.001));
  }, { passive: false });
  // By keyboard: arrows turn, + and - zoom, 0 looks as at first.
  canvas.addEventListener("keydown", (event) => {
    const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.08], ArrowDown: [0, -0.08] }[event.key];
    const factor = { "+": 0.9, "=": 0.9, "-": 1.1 }[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || !(turn || factor || event.key === "0")) return;
    event.preventDefault();
    event.stopPropagation();
    if (turn) {
      fitted = null;
      view.yaw += turn[0];
      view.pitch = Math.max(-0.2, Math.min(1.55, view.pitch + turn[1]));
    } else if (factor) zoom(factor);
    else home();
    touch();
  });
  window.addEventListener("resize", touch);
  home();
  return { draw, touch, place: (x, y, z) => projector()(x, y, z) };
}
