// Plays a run in the scene of a report.
"use strict";

const DATA = JSON.parse(byId("data").textContent);
const MAX_LISTED = 14;
const darkened = matchMedia("(prefers-color-scheme: dark)");
const inksNow = () => (darkened.matches ? DARK : LIGHT);
const colourOf = (track) => inksNow().colours[DATA.colours[track]];

const last = DATA.slots.length - 1;
let frame = DATA.start, playing = false, clock = 0, before = 0;
const listeners = []; // called with the frame whenever it changes

const checked = (id) => Boolean(byId(id) && byId(id).checked);
const scene = makeScene(byId("scene"), DATA, () => ({
  people: (DATA.people[frame] || []).map(([track, joints, radii]) => ({
    colour: colourOf(track), label: String(DATA.tracks[track]), joints, radii: checked("sure") ? radii : null,
  })),
  states: DATA.states.map((states) => states[frame] ?? ASLEEP), // there may be no slot at all
  truth: checked("truth") ? DATA.truth[frame] : [],
  inks: inksNow(),
}));

// ---- pictures beside the scene: the newest one that is not later than the slot

const FILM = JSON.parse(byId("film-data").textContent);

function showFilm() {
  if (!FILM || !FILM.at) return;
  const camera = byId("film-of").selectedIndex, later = FILM.at.findIndex((index) => index > frame);
  byId("film").src = `data:image/jpeg;base64,${FILM.jpeg[camera][(later < 0 ? FILM.at.length : later) - 1]}`;
  byId("film").alt = `Picture of camera ${FILM.cameras[camera]} with the people drawn in`;
}

// ---- playing

function seek(index) {
  frame = Math.max(0, Math.min(last, index));
  clock = DATA.times[frame];
  byId("scrub").value = frame;
  byId("where").textContent = `slot ${DATA.slots[frame]} · ${DATA.times[frame].toFixed(2)} s`;
  showPeople();
  showReasons();
  showFilm();
  scene.touch();
  for (const listener of listeners) listener(frame);
}

function showPeople() {
  const list = byId("people");
  list.replaceChildren();
  const tracks = (DATA.people[frame] || []).map(([track]) => track).sort((a, b) => DATA.tracks[a] - DATA.tracks[b]);
  for (const track of tracks.slice(0, MAX_LISTED)) {
    const item = document.createElement("li"), swatch = document.createElement("i");
    swatch.style.background = colourOf(track);
    item.append(swatch, `person ${DATA.tracks[track]}`);
    list.append(item);
  }
  if (!tracks.length) list.append("no people");
  if (tracks.length > MAX_LISTED) list.append(`and ${tracks.length - MAX_LISTED} more`);
  const awake = DATA.cameras.filter((_, camera) => DATA.states[camera][frame] === AWAKE);
  const blind = DATA.blind[DATA.slots[frame]];
  byId("awake").textContent = blind ? `none: blind slot, ${blind}` : awake.length ? awake.join(", ") : "none";
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
  scene.draw();
  requestAnimationFrame(tick);
}

byId("play").addEventListener("click", () => play(!playing));
byId("scrub").addEventListener("input", () => seek(Number(byId("scrub").value)));
for (const box of ["truth", "sure"]) if (byId(box)) byId(box).addEventListener("change", scene.touch);
document.addEventListener("keydown", (event) => {
  if (["SELECT", "INPUT", "BUTTON"].includes(event.target.tagName)) return;
  const action = { " ": () => play(!playing), ArrowRight: () => seek(frame + 1), ArrowLeft: () => seek(frame - 1) }[event.key];
  if (action) event.preventDefault(), action();
});

if (byId("film-of")) byId("film-of").addEventListener("change", showFilm);
darkened.addEventListener("change", () => (showPeople(), scene.touch()));
byId("scrub").max = Math.max(last, 0);
if (last >= 0) seek(DATA.start);
requestAnimationFrame(tick);
