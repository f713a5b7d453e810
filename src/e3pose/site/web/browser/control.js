// Control, for operators: only what the edge says is shown as its setting.
import { html, useRef, useState } from "./vendor/preact.js";
import { control } from "./connection.js";
import { Join } from "./join.js";
import { known, titleOf } from "./known.js";
import { percent } from "./words.js";

export const mayControl = () => known.room.controls && known.room.scope === "write";

// What is typed or dragged is kept until it is sent; then it is what the edge says.
export function Control() {
  const [typed, type] = useState({}), form = useRef(null);
  if (!mayControl()) return null;
  const { num_selected, target_error_mm, quality_weight } = known.status || {};
  const value = { cameras: typed.cameras ?? num_selected ?? 1, target: typed.target ?? target_error_mm ?? "", weight: typed.weight ?? quality_weight ?? "" };
  const keep = (name) => ({ target }) => type((before) => ({ ...before, [name]: target.value }));
  const byTarget = typed.cameras === undefined && (target_error_mm != null || num_selected == null);
  const send = (event) => {
    event.preventDefault();
    const body = value.target ? { target_error_mm: Number(value.target) } : { cameras: Number(value.cameras) };
    if (value.weight !== "") body.quality_weight = Number(value.weight);
    document.activeElement.blur();
    control("/api/control/loop", body).then(() => type({}));
  };
  return html`<section id="control" aria-labelledby="control-title"><h2 id="control-title">Control</h2>
    <form id="loop" ref=${form} onSubmit=${send}>
      <label>Active cameras per slot <output id="cameras-out">${byTarget ? "by target" : value.cameras}</output>
        <input id="cameras" type="range" min="0.5" step="0.5" max=${known.room.cameras.length} value=${value.cameras} onInput=${keep("cameras")}
          onChange=${(event) => control("/api/control/loop", { cameras: Number(event.target.value) }).then(() => type({}))} /></label>
      <label>or as many as keep the error below, mm <input id="target" type="number" min="1" max="1000" step="1" value=${value.target} onInput=${keep("target")} /></label>
      <label>Accuracy before energy (V) <input id="weight" type="number" min="0" step="any" value=${value.weight} onInput=${keep("weight")} /></label>
      <button type="submit">Apply</button>
    </form>
    ${known.room.tests && html`<p><button type="button" id="test-notice" onClick=${() => control("/api/control/test-notice", {})}>Send a test notice</button></p>`}
    <p id="said" class="soft" role="status">${known.said}</p>${known.room.joins && html`<${Join} />`}</section>`;
}

export function CameraControls({ camera }) {
  const path = `/api/control/cameras/${encodeURIComponent(camera.camera_id)}`, name = titleOf(camera.camera_id);
  const change = (event) => {
    const budget = event.target.value;
    event.target.blur();
    control(path, { budget });
  };
  return html`<td data-head="control"><button type="button" aria-label=${`${camera.paused ? "Resume" : "Pause"} ${name}`} onClick=${() => control(path, { paused: !camera.paused })}>${camera.paused ? "Resume" : "Pause"}</button></td>
    <td data-head="budget"><input aria-label=${`Budget of ${name}`} placeholder=${camera.budget == null ? "budget" : percent(camera.budget)} title="budget: 60%, 4W, 0.3J, until 18:00, for 8h" onChange=${change} /></td>`;
}
