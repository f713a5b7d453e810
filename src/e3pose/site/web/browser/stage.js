// The 3D scene with its switches. The report's renderer draws it; it is made once and kept.
import { html, useEffect, useRef } from "./vendor/preact.js";
import { followSmoothed } from "./connection.js";
import { changed, known, titleOf } from "./known.js";
import { colourOf, nameOf } from "./names.js";
import { sceneInks, whenTurned } from "./palette.js";
import { number, posture, sleeps } from "./words.js";

export let scene = null;
const switches = { sure: true, trails: true };

function cameraState(name) {
  const { mode, shown, status } = known, camera = status && status.cameras.find((one) => one.camera_id === name);
  if (mode === "live" && camera && !camera.online) return sleeps(camera) ? DEEP : LOST;
  if (!shown) return UNKNOWN;
  if (shown.blind) return BLIND;
  if (shown.selected.has(name)) return shown.arrived.has(name) ? AWAKE : LOST;
  return mode === "live" && camera && camera.mode === "aggressive-power-saving" ? DEEP : ASLEEP;
}

function toDraw() {
  return {
    people: (known.shown ? known.shown.people : []).map(({ track, joints, radii }) => ({
      colour: colourOf(track), label: nameOf(track), joints, radii: switches.sure ? radii : null,
      trail: switches.trails ? (known.trails.get(track) || []).map(([, x, y]) => [x, y]) : [],
    })),
    limbs: known.shown?.limbs, neck: known.shown?.neck, // of what is stored; else of the site
    states: known.room.cameras.map(cameraState),
    inks: sceneInks(),
  };
}

// What the scene shows, for who does not see it.
function described() {
  const people = known.shown ? known.shown.people : [];
  if (!people.length) return "3D scene of the room and its cameras: nobody is shown.";
  return `3D scene of the room and its cameras with ${people.length === 1 ? "one person" : `${people.length} people`}: ${people.map(({ track, does }) => `${nameOf(track)}${does.state ? `, ${posture(does).toLowerCase()}` : ""}`).join("; ")}.`;
}

export function Stage() {
  const canvas = useRef(null);
  useEffect(() => {
    scene = makeScene(canvas.current, { ...known.room, cameras: known.room.cameras.map(titleOf) }, toDraw);
    new ResizeObserver(scene.touch).observe(canvas.current);
    whenTurned(scene.touch);
  }, []);
  const box = (name, words) => html`<label><input type="checkbox" id=${name} checked=${switches[name]} onChange=${(event) => ((switches[name] = event.target.checked), scene.touch(), changed())} /> ${words}</label>`;
  return html`<section id="stage" aria-label="Scene">
    <canvas id="scene" ref=${canvas} tabindex="0" role="img" aria-label=${described()} aria-describedby="turning"></canvas>
    <div id="options">
      <${When} />
      ${box("sure", "how sure (discs)")} ${box("trails", "paths")}
      <details class="help"><summary>Moving the view</summary><p id="turning">Drag or arrow keys: turn. Shift-drag or two fingers: move. Wheel, pinch, + and −: zoom. Double-click or 0: as at first. The grid is 1 m. A disc holds its joint in nine of ten cases; a path is of the last 4 s. Active cameras stand out, idle ones are faint, offline ones red.</p></details>
    </div>
  </section>`;
}

// Poses at once or smoothed, where the site publishes both.
function When() {
  const smoothed_ms = known.status?.smoothed_ms ?? null;
  if (known.mode !== "live" || (smoothed_ms === null && !known.smoothed)) return null;
  const choice = (id, on, words) => html`<label><input type="radio" name="when" id=${id} checked=${known.smoothed === on} onChange=${() => followSmoothed(on)} /> ${words}</label>`;
  return html`<span id="when" role="radiogroup" aria-label="poses">${choice("now", false, "now")} ${choice("smoothed", true, html`smoothed, <span id="smoothed-ms">${number(smoothed_ms)}</span> ms later`)}</span>`;
}

export const peopleWords = (count) => (count === null || count === undefined ? "–" : count === 0 ? "nobody there" : count === 1 ? "1 person" : `${count} people`);
