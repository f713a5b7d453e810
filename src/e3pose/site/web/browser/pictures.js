// Pictures of all cameras with the people of their slot drawn in. They are asked for while they
// can be seen: not when the page or the pictures are hidden, and not in the past, as none are stored.
import { html, useEffect, useLayoutEffect, useRef, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { changed, known, titleOf } from "./known.js";
import { colourOf } from "./names.js";
import { isDark } from "./palette.js";
import { ago, cameraWords, clock, complaint, percent } from "./words.js";

const OLD_S = 2, FADED_S = 10, PAGE_PER_S = 10; // requests of this page, for all cameras together
export const tiles = new Map(); // camera to { image, found, have, canvases }
let enlarged = "", folded = false;

const picturesOn = () => known.room.pictures.shown && known.mode === "live" && !document.hidden && !folded;

export function startPictures() {
  for (const name of known.room.cameras) {
    tiles.set(name, { image: null, found: null, have: "", canvases: new Set() });
    if (known.room.pictures.shown) nextPicture(name);
  }
}

async function nextPicture(name) {
  const tile = tiles.get(name), { cameras, pictures } = known.room;
  if (picturesOn()) {
    try {
      const found = await ask(`/api/pictures/${encodeURIComponent(name)}?have=${tile.have}${enlarged === name ? "&large=true" : ""}`);
      if (found.jpeg) tile.image = await decodedImage(found.jpeg);
      if (found.have) tile.have = found.have;
      tile.found = found;
    } catch (error) {
      tile.found = { ...(tile.found || { people: [] }), why: error.message };
    }
    drawTile(name);
  }
  const pause_s = picturesOn() ? Math.max(0.5 / pictures.per_s, cameras.length / PAGE_PER_S) : 0.5;
  setTimeout(() => nextPicture(name), 1000 * pause_s);
}

export async function decodedImage(jpeg) {
  const bytes = Uint8Array.from(atob(jpeg), (letter) => letter.charCodeAt(0));
  return createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
}

export function drawTile(name) {
  const tile = tiles.get(name);
  for (const canvas of tile.canvases) drawPicture(canvas, tile);
  changed();
}

// How old the picture is, or in one line why there is none.
function pictureWords({ image, found }) {
  if (known.mode === "past") return "pictures are not stored";
  if (!found) return "…";
  const old = found.age_s !== null && found.age_s > OLD_S;
  const words = image && old ? [ago(found.age_s)] : [];
  if (found.why) words.push(found.why);
  return words.join(" · ");
}

function largeWords(tile) {
  const { image, found } = tile, words = [pictureWords(tile)];
  if (image) words.push(clock(found.captured_ns / 1e9));
  if (image && found.slot !== null) {
    const apart = Math.round(found.apart_ms);
    words.push(`poses of slot ${found.slot}, ${Math.abs(apart)} ms ${apart < 0 ? "before" : "after"} the image`);
  } else if (image) words.push("no poses of this slot");
  if (image) words.push(`${found.count} pictures so far took about ${found.energy_j.toFixed(2)} J of the camera (modelled)`);
  return words.filter(Boolean).join(" · ");
}

function Picture({ name, width, height, id }) {
  const canvas = useRef(null);
  useEffect(() => {
    const tile = tiles.get(name), drawn = canvas.current;
    tile.canvases.add(drawn);
    drawPicture(drawn, tile);
    return () => tile.canvases.delete(drawn);
  }, [name, known.mode]);
  const { found } = tiles.get(name), old = Boolean(found && (found.why || found.age_s > FADED_S)), now = known.mode === "live";
  return html`<canvas ref=${canvas} id=${id} width=${width} height=${height} class=${now ? (old ? "old" : "") : "none"}></canvas>`;
}

function Tile({ name, open }) {
  const tile = tiles.get(name), camera = (known.told?.cameras || []).find((one) => one.camera_id === name), words = pictureWords(tile);
  const battery = camera && camera.battery != null ? `${camera.gauge ? "" : "~"}${percent(camera.battery)}` : "";
  const gone = known.mode === "live" && camera && cameraWords(camera) === "offline";
  return html`<button type="button" class="tile" onClick=${() => open(name)}>
    <${Picture} name=${name} width="320" height="240" />
    <span class="hidden">Enlarge the picture of </span><b>${titleOf(name)}</b><span class=${gone ? "bad" : ""}>${[cameraWords(camera), battery].filter(Boolean).join(" · ")}</span>
    ${words && html`<span class="why">${words}</span>`}
    ${!known.room.pictures.shown && complaint(camera) && html`<span class="why">${complaint(camera)}</span>`}
  </button>`;
}

export function Pictures() {
  const [name, enlarge] = useState("");
  const box = useRef(null), { shown, why } = known.room.pictures, drawn = [...tiles.values()].some((one) => one.found && one.found.drawn);
  enlarged = name;
  useLayoutEffect(() => {
    if (name && !box.current.open) box.current.showModal();
  }, [name]);
  if (!shown && !why) return null;
  const step = (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key], { cameras } = known.room;
    if (by) enlarge(cameras[(cameras.indexOf(name) + by + cameras.length) % cameras.length]);
  };
  return html`<section id="pictures" aria-labelledby="pictures-title">
    <details open onToggle=${(event) => ((folded = !event.target.open), changed())}><summary><h2 id="pictures-title">Cameras</h2></summary>
    ${why && html`<p id="pictures-why" class="soft">${why}</p>`}
    ${shown && html`<div id="tiles">${known.room.cameras.map((one) => html`<${Tile} key=${one} name=${one} open=${enlarge} />`)}</div>`}
    ${shown && drawn && html`<p id="drawn" class="soft">These cameras play keypoints and have no images: the keypoints are drawn in grey.</p>`}
    </details>
    <dialog id="large" ref=${box} aria-labelledby="large-title" onClose=${() => enlarge("")} onKeyDown=${step} onClick=${(event) => event.target === box.current && box.current.close()}>
      ${name && html`<h2 id="large-title">Picture of <span id="large-of">${titleOf(name)}</span></h2>
      <${Picture} key=${name} id="large-frame" name=${name} width="960" height="720" />
      <p id="large-said" class="soft">${largeWords(tiles.get(name))}</p>
      <p class="soft">Solid limbs were measured, dashed ones are predicted. Arrow keys: other cameras.</p>
      <button id="large-off" type="button" autofocus onClick=${() => box.current.close()}>Close</button>`}
    </dialog>
  </section>`;
}

function drawPicture(canvas, { image, found }) {
  const pen = canvas.getContext("2d");
  if (!image || known.mode === "past") {
    pen.clearRect(0, 0, canvas.width, canvas.height);
    return;
  }
  // As many pixels as the screen has there: skeletons stay sharp where the image is not.
  const width = Math.max(image.width, Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)));
  canvas.width = width;
  canvas.height = Math.round((width * image.height) / image.width);
  pen.drawImage(image, 0, 0, canvas.width, canvas.height);
  const night = found.drawn && isDark(); // keypoints on white paper, turned into its negative
  if (night) {
    pen.globalCompositeOperation = "difference";
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.globalCompositeOperation = "source-over";
  }
  const scale = width / found.size[0];
  pen.lineCap = "round";
  for (const { track, joints_px, measured } of found.people) {
    const lines = known.room.limbs.filter(([i, j]) => joints_px[i][0] !== null && joints_px[j][0] !== null);
    const sure = ([i, j]) => measured[i] && measured[j], thin = width / 210 + 0.9;
    const layers = [[night ? "rgba(0, 0, 0, 0.75)" : "rgba(255, 255, 255, 0.75)", width / 140 + 2.5, lines.filter(sure)], [colourOf(track), thin, lines]];
    for (const [ink, thick, limbs] of layers) {
      pen.strokeStyle = ink;
      pen.lineWidth = thick;
      for (const [i, j] of limbs) {
        pen.setLineDash(sure([i, j]) ? [] : [2 * thin, 2.5 * thin]);
        pen.beginPath();
        pen.moveTo(scale * joints_px[i][0], scale * joints_px[i][1]);
        pen.lineTo(scale * joints_px[j][0], scale * joints_px[j][1]);
        pen.stroke();
      }
    }
  }
  pen.setLineDash([]);
}
