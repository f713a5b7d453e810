// Pictures of all cameras with the people of their moment drawn in. They are asked for while they
// can be seen: not when the page or the strip is hidden, and not in the past, as none are stored.
"use strict";

const OLD_S = 2, FADED_S = 10, PAGE_PER_S = 10; // requests of this page, for all cameras together
const tiles = new Map(); // camera to { canvas, said, image, found, have }
let enlarged = "";

const picturesOn = () => room.pictures.shown && mode === "live" && !document.hidden && byId("pictures-box").open;
const agoWords = (s) => (s < 60 ? `${Math.round(s)} s ago` : s < 5400 ? `${Math.round(s / 60)} min ago` : `${Math.round(s / 3600)} h ago`);

function startPictures() {
  const { shown, why } = room.pictures;
  byId("pictures-box").hidden = !shown && !why;
  byId("pictures-why").textContent = why;
  byId("pictures-legend").hidden = !shown;
  if (!shown) return;
  for (const name of room.cameras) {
    const tile = document.createElement("button"), canvas = document.createElement("canvas"), said = document.createElement("span");
    const title = document.createElement("b");
    tile.type = "button";
    tile.className = "tile";
    tile.setAttribute("aria-label", `Enlarge the picture of ${name}`);
    [canvas.width, canvas.height] = [320, 240];
    title.append(name);
    tile.append(canvas, title, said);
    tile.addEventListener("click", () => enlarge(name));
    byId("tiles").append(tile);
    tiles.set(name, { canvas, said, image: null, found: null, have: "" });
    nextPicture(name);
  }
  const box = byId("large");
  box.addEventListener("close", () => {
    enlarged = "";
  });
  box.addEventListener("click", (event) => event.target === box && box.close());
  byId("large-off").addEventListener("click", () => box.close());
  box.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key], count = room.cameras.length;
    if (step) enlarge(room.cameras[(room.cameras.indexOf(enlarged) + step + count) % count]);
  });
}

function enlarge(name) {
  enlarged = name;
  byId("large-of").textContent = name;
  if (!byId("large").open) byId("large").showModal();
  drawTile(name);
}

async function nextPicture(name) {
  const tile = tiles.get(name);
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
  } else if (mode === "past") {
    drawTile(name);
  }
  const pause_s = picturesOn() ? Math.max(0.5 / room.pictures.per_s, room.cameras.length / PAGE_PER_S) : 0.5;
  setTimeout(() => nextPicture(name), 1000 * pause_s);
}

async function decodedImage(jpeg) {
  const bytes = Uint8Array.from(atob(jpeg), (letter) => letter.charCodeAt(0));
  return createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
}

// How old the picture is, or in one line why there is none.
function pictureWords({ image, found }) {
  if (mode === "past") return "not stored";
  if (!found) return "…";
  const old = found.age_s !== null && found.age_s > OLD_S;
  const words = image ? [old ? agoWords(found.age_s) : clock(found.captured_ns / 1e9)] : [];
  if (found.why) words.push(found.why);
  if (image && !old && found.slot === null) words.push("no poses of this moment");
  return words.join(" · ");
}

function drawTile(name) {
  const tile = tiles.get(name), { canvas, image, found, said } = tile;
  byId("drawn").hidden = ![...tiles.values()].some((one) => one.found && one.found.drawn);
  said.textContent = pictureWords(tile);
  said.className = mode === "live" && found && found.why ? "why" : ""; // has a row of its own
  canvas.classList.toggle("old", mode === "past" || Boolean(found && (found.why || found.age_s > FADED_S)));
  drawPicture(canvas, tile);
  if (enlarged !== name) return;
  drawPicture(byId("large-frame"), tile);
  byId("large-said").textContent = largeWords(tile);
}

function largeWords(tile) {
  const { image, found } = tile, words = [pictureWords(tile)];
  if (image && found.slot !== null) {
    const apart = Math.round(found.apart_ms);
    words.push(`poses of slot ${found.slot}, ${Math.abs(apart)} ms ${apart < 0 ? "before" : "after"} the image`);
  }
  if (image) words.push(`${found.count} pictures so far took about ${found.energy_j.toFixed(2)} J of the camera (modelled)`);
  return words.join(" · ");
}

function drawPicture(canvas, { image, found }) {
  const pen = canvas.getContext("2d");
  if (!image || mode === "past") {
    pen.clearRect(0, 0, canvas.width, canvas.height);
    return;
  }
  // As many pixels as the screen has there: skeletons stay sharp where the image is not.
  const width = Math.max(image.width, Math.round(canvas.clientWidth * (window.devicePixelRatio || 1)));
  canvas.width = width;
  canvas.height = Math.round((width * image.height) / image.width);
  pen.drawImage(image, 0, 0, canvas.width, canvas.height);
  const scale = width / found.size[0];
  pen.lineCap = "round";
  for (const { track, joints_px, measured } of found.people) {
    const lines = room.limbs.filter(([i, j]) => joints_px[i][0] !== null && joints_px[j][0] !== null);
    const sure = ([i, j]) => measured[i] && measured[j], thin = width / 210 + 0.9;
    const layers = [["rgba(255, 255, 255, 0.75)", width / 140 + 2.5, lines.filter(sure)], [colourOf(track), thin, lines]];
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
