// Walk: record somebody who walks; what is covered fills while they do, with hints where to go.
import { html, useEffect, useState } from "../vendor/preact.js";
import { inks } from "../palette.js";
import { usePicture } from "./cameras.js";
import { boundsOf, Floor } from "./floor.js";
import { busy, taskOf, order, question, running, setup, turnTo } from "./state.js";

const COVER_MS = 1000;

// What the walk covers so far, of the recorder while it runs, else what was kept of it.
function useCovered(kind, kept) {
  const [found, see] = useState(null), at = taskOf(kind)?.state === "running";
  useEffect(() => {
    if (!at) return undefined;
    const look = () => question("covered").then(see, () => {});
    look();
    const timer = setInterval(look, COVER_MS);
    return () => clearInterval(timer);
  }, [at, kind]);
  return at ? found : kept;
}

function Picture({ camera, live }) {
  const found = usePicture(camera.id, !live), rows = camera.seen, columns = rows[0].length;
  const most = Math.max(1, ...rows.flat());
  return html`<li class="seen"><div class="frame">
      ${live && found?.jpeg ? html`<img src=${`data:image/jpeg;base64,${found.jpeg}`} alt=${`Picture of ${camera.id}`} />` : ""}
      <svg viewBox=${`0 0 ${columns} ${rows.length}`} preserveAspectRatio="none" aria-hidden="true">${rows.flatMap((row, y) => row.map((count, x) => (count ? html`<rect x=${x} y=${y} width="1" height="1" opacity=${0.25 + 0.4 * Math.min(1, count / most)} />` : null)))}</svg></div>
    <b>${camera.id}</b> <span>${camera.people} poses</span><span class="soft">people in ${Math.round(100 * camera.share)} % of the width</span></li>`;
}

// Seconds in which each two cameras saw somebody at once.
function Pairs({ pairs, cameras }) {
  const of = (a, b) => pairs.find((one) => (one.a === a && one.b === b) || (one.a === b && one.b === a));
  const names = cameras.map((one) => one.id);
  return html`<h3>Seen by two cameras at once</h3><div class="scroll" tabindex="0" role="region" aria-label="Seconds in which two cameras saw somebody at once"><table class="pairs"><thead><tr><td></td>${names.map((name) => html`<th scope="col">${name}</th>`)}</tr></thead>
    <tbody>${names.map((a) => html`<tr><th scope="row">${a}</th>${names.map((b) => html`<td class=${a === b ? "" : of(a, b).seconds >= 6 ? "good" : "few"}>${a === b ? "" : `${of(a, b).seconds.toFixed(0)} s`}</td>`)}</tr>`)}</tbody></table></div>`;
}

function Map({ covered }) {
  const { floor, cell_m, centers, cameras } = covered;
  const cells = floor.map(([x, y]) => ({ x: x * cell_m, y: y * cell_m, size: cell_m, colour: inks().stored }));
  const places = centers.map(([x, y], i) => ({ id: cameras[i].id, x, y }));
  const bounds = boundsOf([...places.map((one) => [one.x, one.y]), ...cells.map(({ x, y }) => [x, y])], 1);
  return html`<h3>Floor</h3><${Floor} id="walk-floor" bounds=${bounds} cells=${cells} cameras=${places} label=${`Map of the floor: people were in ${cells.length} cells of half a metre`} />`;
}

export function Covered({ kind, kept }) {
  const covered = useCovered(kind, kept), live = taskOf(kind)?.state === "running";
  if (!covered) return live ? html`<p class="soft">Waiting for the first seconds …</p>` : null;
  const { hints, enough, seconds, length, centers } = covered;
  return html`<div id="covered"><p id="enough" class=${enough ? "good verdict" : "verdict"} role="status">${enough ? "Enough: stop whenever you like." : hints[0]}</p>
    ${hints.length > 1 && html`<ul class="hints">${hints.slice(1, 4).map((hint) => html`<li>${hint}</li>`)}</ul>`}
    <p class="soft">${length.toFixed(0)} s recorded, ${seconds.toFixed(0)} s of them with somebody in two cameras.</p>
    <ul class="pictures">${covered.cameras.map((camera) => html`<${Picture} key=${camera.id} camera=${camera} live=${live} />`)}</ul>
    ${centers.length > 0 && html`<${Map} covered=${covered} />`}
    <${Pairs} pairs=${covered.pairs} cameras=${covered.cameras} /></div>`;
}

export function Record({ which, words, again }) {
  const task = taskOf(which), live = task?.state === "running";
  return html`<p class="row">${live
    ? html`<button type="button" id="enough-stop" class="main" disabled=${task.stopping} onClick=${() => order("stop")}>${task.stopping ? "Stopping …" : "Stop and keep the walk"}</button>`
    : html`<button type="button" id=${`record-${which}`} class=${again ? "" : "main"} disabled=${busy() || running()} onClick=${() => order(`record/${which}`)}>${again ? "Record again" : words}</button>`}</p>
    ${running() && html`<p class="notice">The site is running and has its cameras: stop it under Go live first.</p>`}`;
}

export function Walk() {
  const { walk } = setup.state;
  return html`<p>Let one person walk through all of the room, upright, for half a minute or more: along the walls, across the middle, past every camera. Keypoints are recorded. A small picture of each camera a second is kept in the site's folder, to draw people over, until you go live.</p>
    ${walk && !busy() && html`<p><button type="button" id="next" class="main" onClick=${() => turnTo("solve")}>Next: solve</button></p>`}
    <${Record} which="walk" words="Start recording" again=${Boolean(walk)} />
    <${Covered} kind="walk" kept=${walk} />`;
}
