// What the page knows of the site, and who is told when that changed. Everything else is computed
// from it. Whatever comes from the site is text, never markup.

const TRAIL_S = 4;
export const HISTORY_S = 30;
const EVERY_MS = 90; // lists and words are drawn so often at most; canvases as often as they like

export const known = {
  room: null, // what does not change
  status: null, // the newest of the edge
  told: null, // status of the moment shown: the newest, or made from what is stored
  edge: { there: false, heard_ns: null }, // whether the server hears the edge
  connected: false,
  lostAt: Date.now(), // since when there is no connection to the server
  mode: "live", // or past
  smoothed: false, // whether the smoothed poses are followed
  shown: null, // the slot that is drawn
  cameAt: 0, // when the newest slot came, by performance.now()
  history: [], // slots of the last half minute before it, oldest first
  trails: new Map(), // track to [[t, x, y], ...] in millimetres
  run: null, // number of the run that runs, of the store; null while it is not there
  called: new Map(), // what tracks of runs are called, see names.js
  happened: [], // what people did, oldest first, see happened.js
  clips: [], // of the store, newest first
  tab: location.hash === "#keep" ? "keep" : "watch",
  notice: "", // what the past has to say
  said: "", // answer of the edge to a control
  wall: false,
};

const listeners = new Set();
let due = 0, last_ms = 0;

// Call a function whenever something changed, soon after.
export function whenChanged(listener) {
  listeners.add(listener);
}

export function changed() {
  if (due) return;
  due = setTimeout(() => {
    due = 0;
    last_ms = performance.now();
    for (const listener of listeners) listener();
  }, Math.max(0, EVERY_MS - (performance.now() - last_ms)));
}

// A slot of the live stream or of the store as it is drawn.
export function prepared(slot, selected, arrived) {
  const t = slot.time_ns / 1e9;
  const people = slot.people.map((person) => ({
    track: person.track,
    does: person,
    joints: person.joints_m.flatMap((point) => (point[0] === null ? [null, null, null] : point.map((v) => 1000 * v))),
    radii: person.sigma_m.map((sigma) => (sigma === null ? null : 1000 * NINETY * sigma)),
  }));
  const late_ms = slot.delay_ms ? (slot.published_ns - slot.time_ns) / 1e6 : null;
  return { slot: slot.slot, t, late_ms, people, selected: new Set(selected), arrived: new Set(arrived), blind: slot.blind || "" };
}
const NINETY = 2.5003; // radius of the ball that holds a joint in nine of ten cases, in sigmas of an axis

function middle(joints) {
  let [x, y, n] = [0, 0, 0];
  for (let i = 0; i < joints.length; i += 3) if (joints[i] !== null) (x += joints[i]), (y += joints[i + 1]), n++;
  return n ? [x / n, y / n] : null;
}

// What people call a camera.
export const titleOf = (id) => known.room.titles[id] ?? id;

// Keep what trails and the strip of cameras show of a slot.
export function remember(now) {
  const { trails, history } = known;
  for (const { track, joints } of now.people) {
    const place = middle(joints);
    if (!place) continue;
    if (!trails.has(track)) trails.set(track, []);
    trails.get(track).push([now.t, ...place]);
  }
  for (const [track, trail] of trails) {
    while (trail.length && (trail[0][0] < now.t - TRAIL_S || trail[0][0] > now.t + 1)) trail.shift();
    if (!trail.length) trails.delete(track);
  }
  history.push(now);
  while (history.length && (history[0].t < now.t - HISTORY_S || history[0].t > now.t + 1)) history.shift();
}

// Draw a slot from now on; others are told.
export function show(now) {
  known.shown = now;
  if (known.mode === "past") for (const zone of known.room.zones) zone.count = now.people.filter(({ does }) => (does.zones || []).some(({ name }) => name === zone.name)).length;
  remember(now);
  changed();
}

// Nothing is known of a time: nothing is shown of another.
export function showNothing() {
  known.shown = null;
  known.history.length = 0;
  known.trails.clear();
  changed();
}
