// Starts the page and lays it out: what people look at first stands first.
import { html, render } from "./vendor/preact.js";
import { ask, drawWaiting, follow } from "./connection.js";
import { Control } from "./control.js";
import { Details } from "./details.js";
import { Energy } from "./energy.js";
import { Events } from "./events.js";
import { changed, known, whenChanged } from "./known.js";
import { Keep, keeps } from "./keep.js";
import { Notices } from "./notices.js";
import { findSpan, learnDay, past, playPast, setPlaying } from "./past.js";
import { People } from "./people.js";
import { Pictures, startPictures } from "./pictures.js";
import { peopleWords, scene, Stage } from "./stage.js";
import { Timeline } from "./timeline.js";

const QUIET_MS = 3000, LOOK_MS = 500;
const root = document.getElementById("page");
let before_ms = 0, drawn = null;

function stateWord() {
  const { mode, connected, status, edge, cameAt } = known;
  if (mode === "past") return "past";
  if (!connected) return "no connection";
  if (!edge.there) return status ? "edge gone" : "waiting";
  return performance.now() - cameAt < QUIET_MS && known.shown ? "live" : status ? "no slots" : "waiting";
}

// The wall: scene, pictures and people alone, as large as the screen is.
function toggleWall() {
  known.wall = !known.wall;
  if (known.wall) document.documentElement.requestFullscreen?.().catch(() => {});
  else if (document.fullscreenElement) document.exitFullscreen();
  changed();
}

// Watching, or keeping: the address remembers which.
function Tabs() {
  const open = (tab) => () => {
    known.tab = tab;
    history.replaceState(null, "", tab === "keep" ? "#keep" : location.pathname);
    changed();
  };
  const one = (tab, words) => html`<button type="button" id=${`tab-${tab}`} aria-pressed=${known.tab === tab} onClick=${open(tab)}>${words}</button>`;
  return html`<nav aria-label="Parts of the page">${one("watch", "Watch")}${one("keep", "Keep")}</nav>`;
}

function Head() {
  const word = stateWord(), count = known.mode === "past" && !known.shown ? null : known.told?.people ?? known.shown?.people.length;
  return html`<header><h1 id="site">${known.room.site}</h1>
    <b id="state" class=${`pill ${{ past: "past", live: "live" }[word] || "off"}`}>${word}</b>
    <span id="count" class="count">${peopleWords(count)}</span>
    ${keeps() && html`<${Tabs} />`}
    <button type="button" id="wall" aria-pressed=${known.wall} onClick=${toggleWall}>${known.wall ? "Leave the wall" : "Wall"}</button></header>`;
}

function Page() {
  const word = stateWord();
  document.body.className = [known.wall ? "wall" : "", ["no connection", "edge gone"].includes(word) ? "stale" : ""].join(" ").trim();
  const keeping = known.tab === "keep" && keeps(), blindfold = !(known.room.pictures.shown || known.room.pictures.why);
  return html`<${Head} /><${Notices} />
    <main class=${keeping ? "keeping" : blindfold ? "blindfold" : ""}><${Stage} />${keeping ? html`<${Keep} />` : html`<${Pictures} />`}
    <aside aria-label="People and what happened"><${People} />${!keeping && html`<${Events} />`}</aside>
    <${Timeline} />${!keeping && html`<${Energy} /><${Control} /><${Details} />`}</main>`;
}

function tick(now_ms) {
  drawWaiting();
  if (known.mode === "past") playPast(Math.min((now_ms - before_ms) / 1000, 0.5));
  before_ms = now_ms;
  if (known.shown !== drawn) {
    drawn = known.shown;
    scene?.touch();
  }
  scene?.draw();
  requestAnimationFrame(tick);
}

// Space pauses the past, wherever it does not press or write something.
function space(event) {
  if (event.key !== " " || known.mode !== "past" || ["BUTTON", "SUMMARY", "INPUT", "TEXTAREA"].includes(event.target.tagName)) return;
  event.preventDefault();
  setPlaying(!past.playing);
}

async function openPast() {
  await findSpan();
  await learnDay(Date.now() / 1000);
}

async function start() {
  try {
    known.room = await ask("/api/site");
  } catch (error) {
    render(html`<header><h1>e3pose</h1><b id="state" class="pill off">no access</b></header>
      <p id="notice" class="notice" role="alert">${error.message}. Open the whole address that e3pose view printed, with the token.</p>`, root);
    return;
  }
  document.title = `${known.room.site} · e3pose`;
  startPictures();
  const draw = () => render(html`<${Page} />`, root);
  root.replaceChildren();
  draw();
  whenChanged(draw);
  whenChanged(() => scene?.touch());
  document.addEventListener("keydown", space);
  document.addEventListener("fullscreenchange", () => (document.fullscreenElement || !known.wall || ((known.wall = false), changed())));
  follow();
  setInterval(changed, LOOK_MS); // time passes, also without slots
  if (known.room.stored) openPast().catch((error) => ((known.notice = error.message), changed()));
  requestAnimationFrame(tick);
}

start();
