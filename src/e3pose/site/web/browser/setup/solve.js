// Solve: where the cameras stand, with the people drawn over each picture; clicks set the axes.
import { html, useEffect, useRef, useState } from "../vendor/preact.js";
import { inks } from "../palette.js";
import { busy, taskOf, order, question, running, setup, shown, stepOf, turnTo } from "./state.js";

const WIDE = 640, SOLVED = "#0a9396";
const AXES = [["x", 1], ["y", 2]];

function limbs(pen, joints, pairs, scale) {
  pen.beginPath();
  for (const [i, j] of pairs) {
    if (!joints[i] || !joints[j]) continue;
    pen.moveTo(scale * joints[i][0], scale * joints[i][1]);
    pen.lineTo(scale * joints[j][0], scale * joints[j][1]);
  }
  pen.stroke();
}

async function draw(canvas, camera, pairs, axes) {
  const [width, height] = camera.size, scale = WIDE / width, pen = canvas.getContext("2d");
  const image = camera.jpeg ? await createImageBitmap(await (async () => new Blob([Uint8Array.from(atob(camera.jpeg), (one) => one.charCodeAt(0))], { type: "image/jpeg" }))()) : null;
  [canvas.width, canvas.height] = [WIDE, Math.round(scale * height)];
  pen.fillStyle = inks().idle;
  pen.fillRect(0, 0, canvas.width, canvas.height);
  if (image) pen.drawImage(image, 0, 0, canvas.width, canvas.height);
  pen.lineCap = "round";
  for (const joints of camera.solved) {
    [pen.lineWidth, pen.strokeStyle] = [8, "rgba(255, 255, 255, 0.85)"];
    limbs(pen, joints, pairs, scale);
    [pen.lineWidth, pen.strokeStyle] = [4, SOLVED];
    limbs(pen, joints, pairs, scale);
  }
  for (const joint of camera.measured.flat()) {
    if (!joint) continue;
    [pen.fillStyle, pen.strokeStyle, pen.lineWidth] = ["#ffffff", "#111827", 1.5];
    pen.beginPath();
    pen.arc(scale * joint[0], scale * joint[1], 3.5, 0, 7);
    (pen.fill(), pen.stroke());
  }
  pen.font = "bold 15px system-ui, sans-serif";
  for (const [name, index] of AXES) {
    if (!axes[0] || !axes[index]) continue;
    [pen.lineWidth, pen.strokeStyle, pen.fillStyle] = [3, "#ffb000", "#ffb000"];
    pen.beginPath();
    pen.moveTo(scale * axes[0][0], scale * axes[0][1]);
    pen.lineTo(scale * axes[index][0], scale * axes[index][1]);
    pen.stroke();
    pen.fillText(name, scale * axes[index][0] + 5, scale * axes[index][1] - 4);
  }
}

function Overlay({ camera, pairs, axes, mode, result, moved }) {
  const canvas = useRef(null), [width, height] = camera.size;
  useEffect(() => void draw(canvas.current, camera, pairs, axes), [camera, axes]);
  const click = async (event) => {
    if (!mode) return;
    const x = (event.offsetX / canvas.current.clientWidth) * width, y = (event.offsetY / canvas.current.clientHeight) * height;
    const done = await order("world", { camera: camera.id, x, y, what: mode });
    if (done) ((setup.said = done.command), moved());
  };
  return html`<li class="overlay"><canvas ref=${canvas} width=${WIDE} height=${Math.round((WIDE * height) / width)} class=${mode ? "aim" : ""} role="img" aria-label=${`People as solved, over the picture of ${camera.id}`} onClick=${click}></canvas>
    <p><b>${camera.id}</b> ${result && html`<span class=${`grade ${result.grade}`}>${{ good: "good", fair: "fair", poor: "poor", unknown: "not known" }[result.grade]}</span> ${result.words}`}</p></li>`;
}

function Pictures({ solve }) {
  const [found, see] = useState(null), [mode, aim] = useState(""), [why, complain] = useState("");
  const load = () => question("overlays").then(see, (error) => complain(error.message));
  useEffect(() => void load(), [solve]);
  if (why) return html`<p class="soft">${why}</p>`;
  if (!found) return html`<p class="soft" role="status">Drawing the people into the pictures …</p>`;
  const choice = (what, words) => html`<button type="button" id=${`aim-${what}`} aria-pressed=${mode === what} disabled=${busy() || running()} onClick=${() => aim(mode === what ? "" : what)}>${words}</button>`;
  return html`<h3>Do the people fit?</h3><p class="soft">Coloured: as solved from all cameras. White dots: as this camera saw them.${found.cameras.some((one) => one.jpeg) ? "" : " No picture of the walk is kept any more."}</p>
    <p class="row">${choice("origin", "Set the origin")}${choice("x-axis", "Set the x axis")}
    <span class="soft">${mode ? `Click ${mode === "origin" ? "the origin" : "a point of the x axis"} on the floor, in any picture.` : "or leave the origin where people walked most"}</span></p>
    ${setup.said && html`<p class="soft">Done. The same: <code>${setup.said}</code></p>`}
    <ul class="overlays">${found.cameras.map((camera, index) => html`<${Overlay} key=${camera.id} camera=${camera} pairs=${found.limbs} axes=${found.axes[index]} mode=${mode} result=${solve?.cameras.find((one) => one.id === camera.id)} moved=${() => (aim(""), load(), shown())} />`)}</ul>`;
}

export function Solve() {
  const { solve, height_cm, walk } = setup.state, [typed, type] = useState(height_cm ? String(height_cm) : ""), done = stepOf("solve").done;
  const task = taskOf("solve"), off = busy() || running() || !walk;
  const submit = (event) => {
    event.preventDefault();
    order("solve", { height_cm: Number(typed) || 0 });
  };
  return html`<p>Lenses, places and directions of the cameras are found from the person who walked. Their height sets the scale: without it, all sizes may be 6 % off.</p>
    <form onSubmit=${submit}><label class="row">Height of the person, cm <input id="height" type="number" min="50" max="250" step="0.5" value=${typed} onInput=${(event) => type(event.target.value)} /></label>
      <p class="row"><button type="submit" id="solve" class=${done ? "" : "main"} disabled=${off}>${done ? "Solve again" : "Solve"}</button>${done && html`<button type="button" id="next" class="main" disabled=${busy()} onClick=${() => turnTo("check")}>Next: check</button>`}</p></form>
    ${!walk && done && html`<p class="soft">The site was calibrated before. Record a walk to solve it again.</p>`}
    ${solve?.scale && html`<p>${solve.scale}</p>`}
    ${solve?.notes.map((note) => html`<p class="unsure">${note}</p>`)}
    ${done && walk && task?.state !== "running" && html`<${Pictures} solve=${solve} />`}`;
}
