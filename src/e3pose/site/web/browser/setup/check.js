// Check: a second walk tells the error to expect over the floor, and what to do about it.
import { html } from "../vendor/preact.js";
import { boundsOf, Floor } from "./floor.js";
import { busy, order, running, setup, turnTo } from "./state.js";
import { Covered, Record } from "./walk.js";

const COLOURS = { good: "#2e9e6b", fair: "#e0a100", poor: "#d0432f" };

function Result({ check }) {
  const { x_m, y_m, map_mm, good_mm, poor_mm, centers } = check, size = x_m.length > 1 ? x_m[1] - x_m[0] : 0.2;
  const kind = (mm) => (mm <= good_mm ? "good" : mm <= poor_mm ? "fair" : "poor");
  const cells = map_mm.flatMap((row, r) => row.map((mm, c) => (mm === null ? null : { x: x_m[c] - size / 2, y: y_m[r] - size / 2, size, colour: COLOURS[kind(mm)] }))).filter(Boolean);
  const bounds = boundsOf([...centers.map(({ x, y }) => [x, y]), ...cells.map(({ x, y }) => [x, y])]);
  return html`<p id="verdict" class=${`verdict ${check.grade}`}>${check.verdict}</p>
    <${Floor} id="error-map" bounds=${bounds} cells=${cells} cameras=${centers} label=${check.verdict} />
    <ul class="keys"><li><i class="key good"></i>up to ${good_mm} mm</li><li><i class="key fair"></i>up to ${poor_mm} mm</li><li><i class="key poor"></i>more</li><li>no colour: fewer than two cameras see it, or nobody walked near</li></ul>
    ${check.next.length > 0 && html`<h3>What to do</h3><ul class="hints" id="to-do">${check.next.map((line) => html`<li>${line}</li>`)}</ul>`}
    <h3>Cameras</h3><ul class="plain">${check.cameras.map(({ id, words, expected }) => html`<li><b>${id}</b> ${words}; expected error ${expected}</li>`)}</ul>`;
}

export function Check() {
  const { second, check } = setup.state;
  return html`<p>Walk through all of the room again: the first walk hides the errors of the calibration that was made from it. You can also go live without this test.</p>
    <${Record} which="second" words="Record the second walk" again=${Boolean(second)} />
    ${second && html`<p class="row"><button type="button" id="check" class=${check ? "" : "main"} disabled=${busy()} onClick=${() => order("check")}>${check ? "Check again" : "Check"}</button>
      ${check && html`<button type="button" id="next" class="main" disabled=${busy()} onClick=${() => turnTo("live")}>Next: go live</button>`}</p>`}
    ${check && !busy() && html`<${Result} check=${check} />`}
    ${(!check || busy()) && html`<${Covered} kind="second" kept=${second} />`}
    ${!second && !busy() && !running() && html`<p><button type="button" class="plain" onClick=${() => turnTo("live")}>Go live without a check</button></p>`}`;
}
