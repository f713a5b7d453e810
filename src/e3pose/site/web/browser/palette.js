// The inks of canvases, by what the system asks for: light or dark. Words and boxes have theirs in view.css.
import { changed } from "./known.js";

const asked = matchMedia("(prefers-color-scheme: dark)");
const STRIPS = {
  light: { text: "#1f2937", soft: "#5b6472", active: "#1f2937", idle: "#e6e9ee", lost: "#b91c1c", blind: "#d97706", hatch: "#d3d9e1", line: "#d5dae2", stored: "#a8c4dd", alarm: "#b91c1c", mark: "#0067a3", cursor: "#0067a3", paper: "#ffffff" },
  dark: { text: "#e2e8f0", soft: "#a3adbb", active: "#e2e8f0", idle: "#2d3542", lost: "#f87171", blind: "#f5a623", hatch: "#333c4a", line: "#333c4a", stored: "#3d5f7e", alarm: "#f87171", mark: "#6cb8ec", cursor: "#6cb8ec", paper: "#14181f" },
};

export const isDark = () => asked.matches;
export const sceneInks = () => (asked.matches ? DARK : LIGHT);
export const inks = () => (asked.matches ? STRIPS.dark : STRIPS.light);

export function whenTurned(listener) {
  asked.addEventListener("change", () => (listener(), changed()));
}

// Size a canvas to what it has on the screen, and return its pen in those pixels.
export function penOf(canvas, height) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth;
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.textBaseline = "middle";
  pen.font = "12px system-ui, sans-serif";
  return pen;
}

const hatches = new Map();

// The pattern of what is not known.
export function hatching(pen) {
  const ink = inks().hatch;
  if (hatches.has(ink)) return hatches.get(ink);
  const tile = document.createElement("canvas");
  tile.width = tile.height = 6;
  const drawn = tile.getContext("2d");
  drawn.strokeStyle = ink;
  drawn.beginPath();
  for (const x of [-3, 3, 9]) (drawn.moveTo(x, 6), drawn.lineTo(x + 6, 0));
  drawn.stroke();
  hatches.set(ink, pen.createPattern(tile, "repeat"));
  return hatches.get(ink);
}
