// The strip of camera selection: what each camera did over the last half minute. What this page has
// not seen is unknown, neither idle nor a saving.
import { html, useLayoutEffect, useRef, useState } from "./vendor/preact.js";
import { HISTORY_S, known, titleOf } from "./known.js";
import { hatching, inks, penOf } from "./palette.js";
import { causeWords, clock } from "./words.js";

export const ROW = 16;

// What a camera did in a slot: its ink and words.
function didIn(slot, name) {
  if (slot.blind) return ["blind", `blind slot, ${causeWords(slot.blind)}`];
  if (!slot.selected.has(name)) return ["idle", "idle"];
  return slot.arrived.has(name) ? ["active", "active"] : ["lost", "view lost"];
}

// The time at the right: of the newest slot, or later where slots should have come since.
export function stripEnd() {
  const last = known.history.at(-1);
  if (!last) return 0;
  const late_s = (performance.now() - known.cameAt) / 1000;
  return last.t + (known.mode === "live" && late_s > 1 ? late_s : 0);
}

export const leftOf = (pen) => 8 + Math.min(110, Math.max(...known.room.cameras.map((name) => pen.measureText(titleOf(name)).width)));

// When a slot begins on the strip: where the one before ends, if that was seen.
function beginOf(slot, before) {
  return before && before.slot === slot.slot - 1 && slot.t - before.t < 2 ? before.t : slot.t - 1 / known.room.slots_per_s;
}

export function drawStrips(canvas) {
  const { cameras } = known.room, ink = inks(), pen = penOf(canvas, ROW * cameras.length + 4);
  const width = canvas.clientWidth, left = leftOf(pen), end = stripEnd(), scale = (width - left) / HISTORY_S;
  const across = (t) => Math.max(left, Math.min(width, width - (end - t) * scale));
  cameras.forEach((name, row) => {
    const y = row * ROW + 2;
    pen.fillStyle = ink.text;
    pen.fillText(titleOf(name), 0, y + ROW / 2 - 2, left - 6);
    pen.fillStyle = hatching(pen);
    pen.fillRect(left, y, width - left, ROW - 4);
    let run = null; // slots of one ink that follow each other are one bar
    const finish = () => {
      if (!run) return;
      pen.fillStyle = ink[run.did];
      pen.fillRect(across(run.from), y, Math.max(across(run.to) - across(run.from), run.to > end - HISTORY_S ? 1 : 0), ROW - 4);
    };
    known.history.forEach((slot, index) => {
      const [did] = didIn(slot, name), from = beginOf(slot, known.history[index - 1]);
      if (run && run.did === did && from <= run.to) run.to = slot.t;
      else (finish(), (run = { did, from, to: slot.t }));
    });
    finish();
  });
}

// What the pointer is at, in words.
export function atPointer(canvas, { offsetX, offsetY }) {
  const left = leftOf(canvas.getContext("2d")), name = known.room.cameras[Math.floor(offsetY / ROW)];
  const t = stripEnd() - ((canvas.clientWidth - offsetX) / (canvas.clientWidth - left)) * HISTORY_S;
  if (!name || offsetX < left) return "";
  const index = known.history.findIndex((slot) => slot.t >= t);
  const slot = index >= 0 && beginOf(known.history[index], known.history[index - 1]) <= t ? known.history[index] : null;
  return `${titleOf(name)}, ${clock(t)}: ${slot ? `${didIn(slot, name)[1]} (slot ${slot.slot})` : "unknown"}`;
}

// How many slots on the strip were blind, by cause.
function blindWords() {
  const blind = new Map();
  for (const slot of known.history) if (slot.blind) blind.set(slot.blind, (blind.get(slot.blind) || 0) + 1);
  return blind.size ? ` (${[...blind].map(([cause, count]) => `${causeWords(cause)}: ${count}`).join(", ")})` : "";
}

export function Strips() {
  const canvas = useRef(null), [said, say] = useState("");
  useLayoutEffect(() => drawStrips(canvas.current));
  const key = (name, words) => html`<span><i class=${`key ${name}`}></i>${words}</span>`;
  return html`<h3>Active cameras</h3>
    <canvas id="strips" ref=${canvas} role="img" aria-label="Active cameras over the last half minute; the table below has their share" style=${{ height: `${ROW * known.room.cameras.length + 4}px` }}
      onPointerMove=${(event) => say(atPointer(canvas.current, event))} onPointerLeave=${() => say("")}></canvas>
    <p class="soft keys">${key("active", "active")} ${key("idle", "idle")} ${key("lost", "view lost, or offline")}
    ${key("blind", html`blind: no view came although one was due<span id="blind-why">${blindWords()}</span>`)} ${key("unknown", "unknown")} <span>30 s, the newest at the right. ${said}</span></p>`;
}
