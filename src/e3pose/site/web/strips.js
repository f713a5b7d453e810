// The time line of camera selection: what each camera did over the last half minute. What this page
// has not seen is unknown, neither idle nor a saving.
"use strict";

const IDLE_INK = "#e6e9ee", HATCH_INK = "#d3d9e1", ROW = 16;
const CAUSES = { "orders-late": "orders late", "views-late": "views late", "views-missing": "views missing", "cameras-offline": "no camera online" };
const causeWords = (cause) => CAUSES[cause] || cause;

// What a camera did in a slot: its ink and words.
function didIn(slot, name) {
  if (slot.blind) return [BLIND_INK, `blind slot, ${causeWords(slot.blind)}`];
  if (!slot.selected.has(name)) return [IDLE_INK, "idle"];
  return slot.arrived.has(name) ? [INK, "active"] : [LOST_INK, "view lost"];
}

// The time at the right: of the newest slot, or later where slots should have come since.
function strips_end() {
  if (!history30.length) return mode === "past" ? at_s : 0;
  const late_s = (performance.now() - cameAt) / 1000;
  return history30[history30.length - 1].t + (mode === "live" && late_s > 1 ? late_s : 0);
}

let hatch = null;

function hatching(pen) {
  if (hatch) return hatch;
  const tile = document.createElement("canvas");
  tile.width = tile.height = 6;
  const ink = tile.getContext("2d");
  ink.strokeStyle = HATCH_INK;
  ink.beginPath();
  for (const x of [-3, 3, 9]) (ink.moveTo(x, 6), ink.lineTo(x + 6, 0));
  ink.stroke();
  hatch = pen.createPattern(tile, "repeat");
  return hatch;
}

function stripsLeft(pen) {
  pen.font = "12px system-ui, sans-serif";
  return 8 + Math.min(110, Math.max(...room.cameras.map((name) => pen.measureText(name).width)));
}

// When a slot begins on the strip: where the one before ends, if that was seen.
function beginOf(slot, before) {
  return before && before.slot === slot.slot - 1 && slot.t - before.t < 2 ? before.t : slot.t - 1 / room.slots_per_s;
}

function drawStrips() {
  const canvas = byId("strips"), pen = canvas.getContext("2d"), ratio = window.devicePixelRatio || 1;
  canvas.style.height = `${ROW * room.cameras.length + 4}px`;
  const width = canvas.clientWidth;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round((ROW * room.cameras.length + 4) * ratio);
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.textBaseline = "middle";
  const left = stripsLeft(pen), end = strips_end(), scale = (width - left) / STRIP_S;
  const across = (t) => Math.max(left, Math.min(width, width - (end - t) * scale));
  room.cameras.forEach((name, row) => {
    const y = row * ROW + 2;
    pen.fillStyle = INK;
    pen.fillText(name, 0, y + ROW / 2 - 2, left - 6);
    pen.fillStyle = hatching(pen);
    pen.fillRect(left, y, width - left, ROW - 4);
    let run = null; // slots of one ink that follow each other are one bar
    const finish = () => {
      if (!run) return;
      pen.fillStyle = run.ink;
      pen.fillRect(across(run.from), y, Math.max(across(run.to) - across(run.from), run.to > end - STRIP_S ? 1 : 0), ROW - 4);
    };
    history30.forEach((slot, index) => {
      const [ink] = didIn(slot, name), from = beginOf(slot, history30[index - 1]);
      if (run && run.ink === ink && from <= run.to) run.to = slot.t;
      else (finish(), (run = { ink, from, to: slot.t }));
    });
    finish();
  });
  showLegend();
}

// How many slots were blind, by cause: those on the strip, and what the edge counted.
function showLegend() {
  const blind = new Map();
  for (const slot of history30) if (slot.blind) blind.set(slot.blind, (blind.get(slot.blind) || 0) + 1);
  const words = [...blind].map(([cause, count]) => `${causeWords(cause)}: ${count}`);
  byId("blind-why").textContent = words.length ? ` (${words.join(", ")})` : "";
}

// What the pointer is at, in words.
function atPointer(event) {
  const canvas = byId("strips"), left = stripsLeft(canvas.getContext("2d"));
  const name = room.cameras[Math.floor(event.offsetY / ROW)];
  const t = strips_end() - ((canvas.clientWidth - event.offsetX) / (canvas.clientWidth - left)) * STRIP_S;
  if (!name || event.offsetX < left) return "";
  const index = history30.findIndex((slot) => slot.t >= t);
  const slot = index >= 0 && beginOf(history30[index], history30[index - 1]) <= t ? history30[index] : null;
  return `${name}, ${clock(t)}: ${slot ? `${didIn(slot, name)[1]} (slot ${slot.slot})` : "unknown"}`;
}
