// The live page: follows a site over a WebSocket, shows its past from the store (past.js) and the
// pictures of its cameras (pictures.js), and controls it where the token allows. Whatever comes from
// the site is text, never markup.
"use strict";

const NINETY = 2.5003; // radius of the ball that holds a joint in nine of ten cases, in sigmas of an axis
const TRAIL_S = 4, STRIP_S = 30, WINDOW_S = 20, QUIET_S = 3, MAX_WAITING = 1000;
const MODES = { active: "active", "power-saving": "saving", "aggressive-power-saving": "sleeping" };
const sleeps = (camera) => camera.asleep_s != null && camera.asleep_s > -2 && !camera.online && !camera.paused;

// ---- the token: kept for this tab alone, and out of the address bar

const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  sessionStorage.setItem("token", given);
  history.replaceState(null, "", location.pathname);
}
const token = sessionStorage.getItem("token") || "";

async function ask(path, body) {
  const headers = token ? { Authorization: `Bearer ${token}` } : {};
  const options = { headers };
  if (body !== undefined) {
    Object.assign(options, { method: "POST", body: JSON.stringify(body) });
    headers["Content-Type"] = "application/json";
  }
  const answer = await fetch(path, options);
  const said = answer.headers.get("content-type")?.startsWith("application/json") ? await answer.json() : null;
  if (!answer.ok) throw new Error(said && typeof said.detail === "string" ? said.detail : `refused (${answer.status})`);
  return said;
}

// ---- what is known

let room = null, scene = null, status = null, shown = null, mode = "live", cameAt = 0;
let edge = { there: false, heard_ns: null }; // as the server last told: whether it hears the edge
const history30 = []; // slots of the last half minute, oldest first: { t, selected, arrived, blind }
const trails = new Map(); // track to [[t, x, y], ...] in millimetres
const colourOf = (track) => COLOURS[((track % COLOURS.length) + COLOURS.length) % COLOURS.length];

// A time of day, with the day if it is another one than today.
function clock(t) {
  const when = new Date(1000 * t), time = when.toLocaleTimeString();
  return when.toDateString() === new Date().toDateString() ? time : `${when.toLocaleDateString()} ${time}`;
}

// A slot of the live stream or of the store as what the scene draws.
function prepared(slot, selected, arrived) {
  const t = slot.time_ns / 1e9;
  const people = slot.people.map((person) => ({
    track: person.track,
    joints: person.joints_m.flatMap((point) => (point[0] === null ? [null, null, null] : point.map((v) => 1000 * v))),
    radii: person.sigma_m.map((sigma) => (sigma === null ? null : 1000 * NINETY * sigma)),
  }));
  const late_ms = slot.delay_ms ? (slot.published_ns - slot.time_ns) / 1e6 : null;
  return { slot: slot.slot, t, late_ms, people, selected: new Set(selected), arrived: new Set(arrived), blind: slot.blind || "" };
}

function middle(joints) {
  let [x, y, n] = [0, 0, 0];
  for (let i = 0; i < joints.length; i += 3) if (joints[i] !== null) (x += joints[i]), (y += joints[i + 1]), n++;
  return n ? [x / n, y / n] : null;
}

function remember(now) {
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
  history30.push(now);
  while (history30.length && (history30[0].t < now.t - STRIP_S || history30[0].t > now.t + 1)) history30.shift();
}

function cameraState(name) {
  const camera = status && status.cameras.find((one) => one.camera_id === name);
  if (mode === "live" && camera && !camera.online) return sleeps(camera) ? DEEP : LOST;
  if (!shown) return UNKNOWN;
  if (shown.blind) return BLIND;
  if (shown.selected.has(name)) return shown.arrived.has(name) ? AWAKE : LOST;
  return mode === "live" && camera && camera.mode === "aggressive-power-saving" ? DEEP : ASLEEP;
}

function toDraw() {
  const people = shown ? shown.people : [];
  return {
    people: people.map(({ track, joints, radii }) => ({
      colour: colourOf(track),
      label: String(track),
      joints,
      radii: byId("sure").checked ? radii : null,
      trail: byId("trails").checked ? (trails.get(track) || []).map(([, x, y]) => [x, y]) : [],
    })),
    states: room.cameras.map(cameraState),
  };
}

function show(now) {
  shown = now;
  remember(now);
  scene.touch();
  drawStrips();
  const list = now.people.map(({ track }) => {
    const item = document.createElement("li"), swatch = document.createElement("i");
    swatch.style.background = colourOf(track);
    item.append(swatch, `track ${track}`);
    return item;
  });
  byId("people").replaceChildren(...(list.length ? list : ["no people"]));
  const late = now.late_ms === null ? "" : ` · smoothed, published after ${number(now.late_ms)} ms`;
  byId("where").textContent = `${clock(now.t)} · slot ${now.slot}${late}`;
}

// Nothing is known of a time: nothing is shown of another.
function showNothing(t) {
  shown = null;
  history30.length = 0;
  trails.clear();
  byId("people").replaceChildren("unknown");
  byId("where").textContent = t === null ? "" : `${clock(t)} · no slot`;
  scene.touch();
  drawStrips();
  for (const name of tiles.keys()) drawTile(name);
}

// ---- status

const number = (value, places = 0, unit = "") => (value === null || value === undefined ? "–" : value.toFixed(places) + unit);
const percent = (value) => (value === null || value === undefined ? "–" : `${Math.round(100 * value)} %`);
const COLUMNS = [ // name, text of a camera, what it means
  ["camera", (c) => c.camera_id, ""],
  ["mode", (c) => (c.paused ? "paused" : c.online ? MODES[c.mode] || "–" : sleeps(c) ? `asleep ${Math.max(c.asleep_s, 0).toFixed(0)} s` : "offline"),
    "active; saving: idle, but capturing; sleeping: idle, not capturing; asleep by order until it is expected back; paused by an operator; offline"],
  ["duty", (c) => percent(c.duty), "share of the last slots in which the camera was active"],
  ["occlusion", (c) => percent(c.occlusion), "predicted overlap of the people in its view"],
  ["information, nats", (c) => number(c.gain_nats, 2), "expected information of its view at the last decision, per joint"],
  ["price", (c) => number(c.price, 1), "what selecting it costs: grows with its deficit, compared with the information"],
  ["deficit", (c) => number(c.deficit, 1), "energy spent beyond its budget so far, in slots"],
  ["power", (c) => (c.power_w === null ? "–" : `${c.measured ? "" : "~"}${c.power_w.toFixed(1)} W`), "mean power; ~ is modelled, not measured"],
  ["CPU", (c) => (c.cpu_s == null ? "–" : `${c.cpu_s.toFixed(0)} s${c.cpu_saved == null ? "" : `, ${percent(c.cpu_saved)} saved`}`), "measured processor time of its program, and what it saves of looking in every slot"],
  ["battery", (c) => (c.battery === undefined ? "–" : c.battery === null ? "mains" : `${c.gauge ? "" : "~"}${percent(c.battery)}`), "charge; ~ is modelled"],
  ["temperature", (c) => number(c.temperature_c, 0, " °C"), "of the camera's processor"],
  ["late, lost", (c) => (c.late === null ? "–" : `${c.late}, ${c.lost}`), "views that arrived after their slot was closed, and views that did not arrive"],
];

function showStatus(status) {
  const online = status.cameras.filter((camera) => camera.online);
  const watts = online.filter((camera) => camera.power_w !== null);
  byId("count").textContent = status.people ?? "–";
  showBlind(status);
  const aim = status.target_error_mm ? ` of ${number(status.target_error_mm)} mm` : " mm";
  byId("error").textContent = number(status.expected_error_mm, 0, aim);
  byId("rate").textContent = number(status.fps, 1);
  const [usual_ms, worst_ms] = status.latency_ms;
  byId("latency").textContent = usual_ms === null ? "–" : `${number(usual_ms, 1)} ms (99 %: ${number(worst_ms, 0)} ms)`;
  byId("lead").textContent = number(status.lead, 0, status.lead === 1 ? " slot" : " slots");
  byId("of-then").hidden = mode === "live";
  const modelled = watts.some((camera) => !camera.measured) ? "~" : "";
  byId("power").textContent = watts.length ? `${modelled}${watts.reduce((sum, camera) => sum + camera.power_w, 0).toFixed(1)} W` : "–";
  const rows = status.cameras.map((camera) => {
    const row = document.createElement("tr");
    for (const [head, text] of COLUMNS) {
      const cell = row.insertCell();
      cell.dataset.head = head; // on a narrow page each row is a card, whose cells name themselves
      cell.append(text(camera));
    }
    controlCells(row, camera);
    if (camera.why) {
      const why = row.insertCell();
      why.className = "why";
      why.append(camera.why);
    }
    return row;
  });
  const focused = document.activeElement;
  if (!(focused && byId("table").contains(focused))) byId("table").tBodies[0].replaceChildren(...rows);
  byId("events").replaceChildren(...status.events.map((text, index) => {
    const item = document.createElement("li"), time = document.createElement("time");
    const at_ns = (status.events_ns || [])[index];
    time.textContent = at_ns ? clock(at_ns / 1e9) : "time unknown";
    item.append(time, ` ${text}`);
    return item;
  }).reverse());
  const smoothed_ms = status.smoothed_ms ?? null;
  byId("when").hidden = mode !== "live" || (smoothed_ms === null && !smoothed);
  if (smoothed_ms !== null) byId("smoothed-ms").textContent = number(smoothed_ms);
  if (mode !== "live") return;
  showSettings();
  scene.touch();
}

// Slots for which no view arrived although one was due: of the last minute, and since the start.
function showBlind({ blind_share, blind, slots }) {
  const share = blind_share ?? null, total = Object.values(blind || {}).reduce((sum, count) => sum + count, 0);
  const causes = Object.entries(blind || {}).map(([cause, count]) => `${causeWords(cause)}: ${count}`).join(", ");
  byId("blind").textContent = share !== null && share > 0 && share < 0.01 ? "< 1 %" : percent(share);
  byId("blind").className = share ? "bad" : "";
  byId("blind").title = total ? `since the start ${total} of ${slots} slots (${causes})` : "no view arrived although one was due";
}

let lostAt = Date.now(); // since when there is no connection to the server

function showState() {
  const late = (performance.now() - cameAt) / 1000, pill = byId("state"), open = socket && socket.readyState === 1;
  if (open) lostAt = Date.now();
  const word = mode === "past" ? "past" : !open ? "no connection" : !status ? "waiting" : !edge.there ? "edge gone" : late < QUIET_S ? "live" : "no slots";
  pill.textContent = word;
  pill.className = `pill ${{ past: "past", live: "live" }[word] || "off"}`;
  document.body.classList.toggle("stale", word === "no connection" || word === "edge gone");
  if (mode !== "live") return;
  notice(liveNotice(open));
  if (late > 1 && history30.length) drawStrips(); // time passes, also without slots
}

// What a reader has to know of the live page, in a sentence or two; empty if all is well.
function liveNotice(open) {
  if (!open && Date.now() - lostAt > 1500) {
    return `No connection to e3pose view since ${clock(lostAt / 1000)}: it was stopped, or cannot be reached. The page connects again by itself; what it shows is old.`;
  }
  if (!status && (!open || edge.there)) return "";
  if (!status) return "Waiting for the edge. It is not running, or still starting.";
  if (open && !edge.there) {
    return `Edge gone since ${clock(edge.heard_ns / 1e9)}: it was stopped, or cannot be reached. What is shown is its last state; the page goes on by itself when the edge is back.`;
  }
  if (status.compiling_s != null) {
    return status.compiling_s
      ? `The edge is compiling: ${Math.round(status.compiling_s)} s left. Cameras connect meanwhile and get orders then; this happens only at the first start.`
      : "The edge is getting ready. Cameras connect meanwhile; a first start compiles for a minute or so.";
  }
  if (smoothed && status.smoothed_ms === null) {
    return `The edge publishes no smoothed poses at present: ${status.overload ? "it is overloaded" : "it was started without a delay"}. Choose “now” to see poses.`;
  }
  return status.overload || "";
}

function notice(text) {
  if (byId("notice").textContent === text) return;
  byId("notice").hidden = !text;
  byId("notice").textContent = text;
}

// ---- following

let socket = null, pause_ms = 500, smoothed = false; // whether the smoothed poses are followed
const waiting = []; // slots since the last frame: a browser that is slow draws the newest alone

function follow() {
  const url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live${smoothed ? "?delayed=true" : ""}`;
  socket = new WebSocket(url, token ? ["e3pose", `e3pose.token.${token}`] : ["e3pose"]);
  socket.onmessage = ({ data }) => {
    const event = JSON.parse(data);
    pause_ms = 500;
    if (event.type === "edge") {
      edge = event;
      showState();
    } else if (event.type === "status") {
      status = event;
      if (mode === "live") (showStatus(status), showState());
    } else if (event.type === "slot") {
      cameAt = performance.now();
      for (const zone of room.zones) zone.count = event.zones[zone.name] ?? 0;
      if (mode === "live") waiting.push(prepared(event, event.selected, event.arrived));
      if (waiting.length > MAX_WAITING) waiting.shift(); // a page that is hidden draws nothing
      if (!byId("state").classList.contains(mode)) showState();
    }
    listeners.forEach((listener) => listener(event));
  };
  socket.onclose = () => {
    setTimeout(follow, pause_ms);
    pause_ms = Math.min(2 * pause_ms, 10_000);
  };
}
const listeners = [];

// Follow the smoothed poses, or those at once; what was shown is of the others.
function followSmoothed(on) {
  smoothed = on;
  waiting.length = 0;
  if (socket) socket.onclose = socket.onmessage = null;
  if (socket) socket.close();
  if (mode === "live") showNothing(null);
  follow();
}

// ---- control: only what the edge says is shown as its setting

const mayControl = () => room.controls && room.scope === "write";

function controlCells(row, camera) {
  if (!mayControl() || mode !== "live") return;
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = camera.paused ? "Resume" : "Pause";
  button.addEventListener("click", () => {
    button.blur();
    control(`/api/control/cameras/${encodeURIComponent(camera.camera_id)}`, { paused: !camera.paused });
  });
  row.insertCell().append(button);
  const budget = document.createElement("input");
  budget.placeholder = camera.budget === null ? "budget" : percent(camera.budget);
  budget.title = "budget: 60%, 4W, 0.3J, until 18:00, for 8h";
  budget.addEventListener("change", () => {
    budget.blur();
    control(`/api/control/cameras/${encodeURIComponent(camera.camera_id)}`, { budget: budget.value });
  });
  row.insertCell().append(budget);
}

async function control(path, body) {
  byId("said").textContent = "…";
  try {
    byId("said").textContent = (await ask(path, body)).said;
  } catch (error) {
    byId("said").textContent = error.message;
  }
}

function showSettings() {
  if (!mayControl() || byId("loop").contains(document.activeElement)) return;
  byId("cameras").max = room.cameras.length;
  if (status.num_selected !== null) byId("cameras").value = status.num_selected;
  byId("cameras-out").textContent = status.target_error_mm !== null || status.num_selected === null ? "by target" : status.num_selected;
  byId("target").value = status.target_error_mm ?? "";
  byId("weight").value = status.quality_weight ?? "";
}

// ---- start

let before_ms = 0;

function tick(now_ms) {
  const come = waiting.splice(0);
  if (mode === "live") come.forEach((slot, index) => (index === come.length - 1 ? show(slot) : remember(slot)));
  if (mode === "past") playPast(Math.min((now_ms - before_ms) / 1000, 0.5));
  before_ms = now_ms;
  scene.draw();
  requestAnimationFrame(tick);
}

async function start() {
  try {
    room = await ask("/api/site");
  } catch (error) {
    notice(`${error.message}. Open the whole address that e3pose view printed, with the token.`);
    byId("state").textContent = "no access";
    byId("state").className = "pill off";
    return;
  }
  document.title = `${room.site} · e3pose`;
  byId("site").textContent = room.site;
  const head = byId("table").tHead.insertRow();
  const extra = mayControl() ? ["control", "budget"] : [];
  for (const [name, , meaning] of [...COLUMNS, ...extra.map((name) => [name])]) {
    const cell = document.createElement("th");
    cell.append(name);
    head.append(cell);
    if (!meaning) continue;
    cell.title = meaning;
    const [term, text] = ["dt", "dd"].map((kind) => document.createElement(kind));
    term.append(name);
    text.append(meaning);
    byId("meanings").append(term, text);
  }
  byId("control").hidden = !mayControl();
  scene = makeScene(byId("scene"), room, toDraw);
  for (const box of ["sure", "trails"]) byId(box).addEventListener("change", scene.touch);
  byId("live").addEventListener("click", goLive);
  for (const name of ["now", "smoothed"]) byId(name).addEventListener("change", () => followSmoothed(byId("smoothed").checked));
  byId("strips").addEventListener("pointermove", (event) => (byId("strips").title = byId("strip-said").textContent = atPointer(event)));
  byId("strips").addEventListener("pointerleave", () => (byId("strip-said").textContent = ""));
  byId("play").addEventListener("click", () => setPlaying(!playing));
  document.addEventListener("keydown", (event) => {
    if (event.key !== " " || mode !== "past" || ["BUTTON", "SUMMARY"].includes(event.target.tagName)) return;
    if (event.target.tagName === "INPUT" && event.target.type !== "range") return;
    event.preventDefault();
    setPlaying(!playing);
  });
  byId("scrub").addEventListener("input", () => {
    const share = byId("scrub").value / 1000;
    if (share >= 1) goLive();
    else seek(span.begin_s + share * (end_s() - span.begin_s));
  });
  byId("cameras").addEventListener("input", () => (byId("cameras-out").textContent = byId("cameras").value));
  byId("cameras").addEventListener("change", () => control("/api/control/loop", { cameras: Number(byId("cameras").value) }));
  byId("loop").addEventListener("submit", (event) => {
    event.preventDefault();
    const body = {};
    if (byId("target").value) body.target_error_mm = Number(byId("target").value);
    else body.cameras = Number(byId("cameras").value);
    if (byId("weight").value) body.quality_weight = Number(byId("weight").value);
    document.activeElement.blur();
    control("/api/control/loop", body);
  });
  drawStrips();
  startPictures();
  follow();
  setInterval(showState, 500);
  requestAnimationFrame(tick);
  if (room.stored) findSpan().catch((error) => notice(error.message));
}

start();
