// Details, for engineers: figures of the loop, active cameras, the table of cameras, the log.
import { html } from "./vendor/preact.js";
import { MEANINGS } from "./camera_status.js";
import { CameraControls, mayControl } from "./control.js";
import { known, titleOf } from "./known.js";
import { Strips } from "./strips.js";
import { causeWords, clock, number, percent, sleeps } from "./words.js";

const MODES = { active: "active", "power-saving": "idle", "aggressive-power-saving": "closed" };
const modeOf = (c) => (c.paused ? "paused" : c.online ? MODES[c.mode] || "–" : sleeps(c) ? `asleep ${Math.max(c.asleep_s, 0).toFixed(0)} s` : "offline");
const means = (...names) => names.map((name) => MEANINGS[name]).join("; ");
const COLUMNS = [ // name, text of a camera, what it means
  ["camera", (c) => titleOf(c.camera_id), ""],
  ["mode", modeOf, "active; idle, but capturing; closed: idle, not capturing; asleep by order until it is expected back; paused by an operator; offline"],
  ["duty", (c) => `${percent(c.duty)}${c.unchanged == null ? "" : `, ${percent(c.unchanged)} of looks unchanged`}`, means("duty", "unchanged")],
  ["occlusion", (c) => percent(c.occlusion), means("occlusion")],
  ["information, nats", (c) => number(c.gain_nats, 2), means("gain_nats")],
  ["price", (c) => number(c.price, 1), means("price")],
  ["deficit", (c) => number(c.deficit, 1), means("deficit")],
  ["power", (c) => (c.power_w === null ? "–" : `${c.measured ? "" : "~"}${c.power_w.toFixed(1)} W`), `${means("power_w")}; ~ is modelled`],
  ["CPU", (c) => (c.cpu_s == null ? "–" : `${c.cpu_s.toFixed(0)} s${c.cpu_saved == null ? "" : `, ${percent(c.cpu_saved)} saved`}`), means("cpu_s", "cpu_saved")],
  ["battery", (c) => (c.battery === undefined ? "–" : c.battery === null ? "mains" : `${c.gauge ? "" : "~"}${percent(c.battery)}`), `${means("battery")}; ~ is modelled`],
  ["temperature", (c) => number(c.temperature_c, 0, " °C"), means("temperature_c")],
  ["late, lost", (c) => (c.late === null ? "–" : `${c.late}, ${c.lost}`), means("late", "lost")],
];

// Slots for which no view arrived although one was due: of the last minute, and since the start.
function Blind({ blind_share, blind, slots }) {
  const share = blind_share ?? null, total = Object.values(blind || {}).reduce((sum, count) => sum + count, 0);
  const causes = Object.entries(blind || {}).map(([cause, count]) => `${causeWords(cause)}: ${count}`).join(", ");
  const title = total ? `since the start ${total} of ${slots} slots (${causes})` : "no view arrived although one was due";
  return html`<div><dt>blind slots</dt><dd id="blind" class=${share ? "bad" : ""} title=${title}>${share !== null && share > 0 && share < 0.01 ? "< 1 %" : percent(share)}</dd></div>`;
}

function Figures({ told }) {
  const aim = told.target_error_mm ? ` of ${number(told.target_error_mm)} mm` : " mm", [usual_ms, worst_ms] = told.latency_ms;
  const figure = (id, name, text) => html`<div><dt>${name}</dt><dd id=${id}>${text}</dd></div>`;
  return html`<dl class="figures">
    ${figure("slot", "slot", known.shown ? known.shown.slot : "–")}
    ${figure("error", "expected error", number(told.expected_error_mm, 0, aim))}
    ${figure("rate", "slots per second", number(told.fps, 1))}
    ${figure("latency", "latency", usual_ms === null ? "–" : `${number(usual_ms, 1)} ms (99 %: ${number(worst_ms, 0)} ms)`)}
    ${figure("lead", "lead", number(told.lead, 0, told.lead === 1 ? " slot" : " slots"))}
    <${Blind} ...${told} />
  </dl>`;
}

/** @param {{ camera: import("./camera_status.js").CameraStatus }} row */
function Row({ camera }) {
  return html`<tr>${COLUMNS.map(([head, text], index) => (index ? html`<td data-head=${head}>${text(camera)}</td>` : html`<th scope="row" data-head=${head}>${text(camera)}</th>`))}
    ${mayControl() && known.mode === "live" && html`<${CameraControls} camera=${camera} />`}
    ${camera.why && html`<td class="why">${camera.why}</td>`}</tr>`;
}

function Log({ told }) {
  const lines = told.events.map((text, index) => [(told.events_ns || [])[index], text]).reverse();
  return html`<h3>Log of the site</h3><ol id="events" class="log" tabindex="0" aria-label="Log of the site, newest first">${lines.map(([at_ns, text]) => html`<li><time>${at_ns ? clock(at_ns / 1e9) : "time unknown"}</time> ${text}</li>`)}</ol>`;
}

export function Details() {
  const { told } = known, extra = mayControl() && known.mode === "live" ? ["control", "budget"] : [];
  return html`<section id="details" aria-label="Details"><details id="details-box"><summary><h2>Details</h2> <span class="soft">for engineers: figures, choice of cameras, log</span></summary>
    ${told && html`<${Figures} told=${told} />`}
    <${Strips} />
    <h3>Cameras <span id="of-then" class="soft" hidden=${known.mode === "live"}>as stored at the time shown</span></h3>
    <div class="scroll" tabindex="0" role="region" aria-label="Table of cameras"><table id="table"><thead><tr>${COLUMNS.map(([name, , meaning]) => html`<th scope="col" title=${meaning}>${name}</th>`)}${extra.map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${(told?.cameras || []).map((camera) => html`<${Row} key=${camera.camera_id} camera=${camera} />`)}</tbody></table></div>
    <details class="help"><summary>What the columns mean</summary><dl id="meanings">${COLUMNS.slice(1).map(([name, , meaning]) => html`<dt>${name}</dt><dd>${meaning}</dd>`)}</dl></details>
    ${told && html`<${Log} told=${told} />`}
  </details></section>`;
}
