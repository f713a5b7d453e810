// Speaks with the server: questions with the token, and what it sends by itself over a WebSocket.
import { changed, known, prepared, remember, show, showNothing } from "./known.js";
import { learn } from "./happened.js";
import { learnNames } from "./names.js";

const MAX_WAITING = 1000;

// The token is kept for this tab alone, and out of the address bar.
const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) {
  sessionStorage.setItem("token", given);
  history.replaceState(null, "", location.pathname);
}
const token = sessionStorage.getItem("token") || "";

// What the server answers; an error where it refuses, with its words.
export async function fetched(path, body, method = body === undefined ? "GET" : "POST") {
  const headers = token ? { Authorization: `Bearer ${token}` } : {}, options = { headers, method };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
    headers["Content-Type"] = "application/json";
  }
  const answer = await fetch(path, options);
  if (answer.ok) return answer;
  const said = answer.headers.get("content-type")?.startsWith("application/json") ? await answer.json() : null;
  throw new Error(said && typeof said.detail === "string" ? said.detail : `refused (${answer.status})`);
}

export const ask = async (path, body, method) => (await fetched(path, body, method)).json();

// Ask the edge to change something; its answer is shown.
export async function control(path, body) {
  known.said = "…";
  changed();
  try {
    known.said = (await ask(path, body)).said;
  } catch (error) {
    known.said = error.message;
  }
  changed();
}

let socket = null, pause_ms = 500;
const waiting = []; // slots since the last frame: a browser that is slow draws the newest alone

const take = {
  edge: (event) => (known.edge = event),
  status: (event) => {
    known.status = event;
    known.run = event.run;
    if (event.run !== null) learnNames(event.names.map((one) => ({ ...one, run: event.run })), event.run);
    if (known.mode === "live") known.told = event;
  },
  told: (event) => learn(event.events, "live"),
  slot: (event) => {
    known.cameAt = performance.now();
    for (const zone of known.room.zones) zone.count = event.zones[zone.name] ?? 0;
    if (known.mode === "live") waiting.push(prepared(event, event.selected, event.arrived));
    if (waiting.length > MAX_WAITING) waiting.shift(); // a page that is hidden draws nothing
  },
};

export function follow() {
  const url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live${known.smoothed ? "?delayed=true" : ""}`;
  socket = new WebSocket(url, token ? ["e3pose", `e3pose.token.${token}`] : ["e3pose"]);
  socket.onmessage = ({ data }) => {
    const event = JSON.parse(data);
    pause_ms = 500;
    take[event.type]?.(event);
    changed();
  };
  socket.onopen = () => {
    known.connected = true;
    changed();
  };
  socket.onclose = () => {
    if (known.connected) known.lostAt = Date.now();
    known.connected = false;
    changed();
    setTimeout(follow, pause_ms);
    pause_ms = Math.min(2 * pause_ms, 10_000);
  };
}

// Follow the smoothed poses, or those at once; what was shown is of the others.
export function followSmoothed(on) {
  known.smoothed = on;
  waiting.length = 0;
  if (socket) socket.onclose = socket.onmessage = null;
  if (socket) socket.close();
  if (known.mode === "live") showNothing();
  follow();
}

// Draw what came since the last frame.
export function drawWaiting() {
  const come = waiting.splice(0);
  if (known.mode === "live") come.forEach((slot, index) => (index === come.length - 1 ? show(slot) : remember(slot)));
}
