// A map of the floor: cells of colour, cameras, zones. Lengths in metres, x to the right, y up.
import { html, useEffect, useRef } from "../vendor/preact.js";
import { inks, penOf, whenTurned } from "../palette.js";

const MARGIN = 18, HEIGHT = 340;

// The scale and the place of a map whose low and high corners are given, on a canvas of a size.
export function frameOf([[x0, y0], [x1, y1]], width, height) {
  const scale = Math.min((width - 2 * MARGIN) / (x1 - x0), (height - 2 * MARGIN) / (y1 - y0));
  const left = (width - scale * (x1 - x0)) / 2, top = (height - scale * (y1 - y0)) / 2;
  return {
    scale,
    at: (x, y) => [left + scale * (x - x0), height - top - scale * (y - y0)],
    back: (px, py) => [x0 + (px - left) / scale, y0 + (height - top - py) / scale],
  };
}

export function boundsOf(points, around = 0.5) {
  const xs = points.map(([x]) => x), ys = points.map(([, y]) => y);
  if (!points.length) return [[-2, -2], [2, 2]];
  return [[Math.min(...xs) - around, Math.min(...ys) - around], [Math.max(...xs) + around, Math.max(...ys) + around]];
}

function grid(pen, frame, [[x0, y0], [x1, y1]]) {
  pen.strokeStyle = inks().line;
  pen.lineWidth = 1;
  pen.beginPath();
  for (let x = Math.ceil(x0); x <= x1; x++) (pen.moveTo(...frame.at(x, y0)), pen.lineTo(...frame.at(x, y1)));
  for (let y = Math.ceil(y0); y <= y1; y++) (pen.moveTo(...frame.at(x0, y)), pen.lineTo(...frame.at(x1, y)));
  pen.stroke();
}

function cross(pen, frame) {
  const [ox, oy] = frame.at(0, 0);
  pen.lineWidth = 2;
  pen.strokeStyle = pen.fillStyle = inks().text;
  for (const [name, x, y] of [["x", 1, 0], ["y", 0, 1]]) {
    const [px, py] = frame.at(x, y);
    pen.beginPath();
    pen.moveTo(ox, oy);
    pen.lineTo(px, py);
    pen.stroke();
    pen.fillText(name, px + 4, py - 7);
  }
}

export function Floor({ id, bounds, cells = [], cameras = [], zones = [], label, press = null, height = HEIGHT }) {
  const canvas = useRef(null), drawn = useRef(null);
  drawn.current = () => {
    if (!canvas.current?.clientWidth) return;
    const pen = penOf(canvas.current, height), frame = frameOf(bounds, canvas.current.clientWidth, height);
    for (const { x, y, size, colour } of cells) {
      const [px, py] = frame.at(x, y + size);
      pen.fillStyle = colour;
      pen.fillRect(px, py, frame.scale * size + 0.5, frame.scale * size + 0.5);
    }
    grid(pen, frame, bounds);
    cross(pen, frame);
    for (const { name, corners, open } of zones) {
      pen.strokeStyle = pen.fillStyle = inks().mark;
      pen.lineWidth = 2;
      pen.beginPath();
      corners.forEach(([x, y], index) => pen[index ? "lineTo" : "moveTo"](...frame.at(x, y)));
      if (!open) pen.closePath();
      pen.stroke();
      for (const [x, y] of corners) (pen.beginPath(), pen.arc(...frame.at(x, y), 3.5, 0, 7), pen.fill());
      if (name && corners.length) pen.fillText(name, ...frame.at(corners[0][0], corners[0][1]).map((v, i) => v + (i ? -9 : 6)));
    }
    for (const { id: name, x, y } of cameras) {
      const [px, py] = frame.at(x, y);
      pen.fillStyle = inks().text;
      pen.beginPath();
      pen.arc(px, py, 4, 0, 7);
      pen.fill();
      pen.fillText(name, px + 7 + pen.measureText(name).width > canvas.current.clientWidth ? px - 8 - pen.measureText(name).width : px + 7, py);
    }
  };
  useEffect(() => drawn.current());
  useEffect(() => {
    const look = () => drawn.current(), watch = new ResizeObserver(look);
    watch.observe(canvas.current);
    whenTurned(look);
    return () => watch.disconnect();
  }, []);
  const pressed = press && ((event) => press(frameOf(bounds, canvas.current.clientWidth, height).back(event.offsetX, event.offsetY)));
  return html`<canvas ref=${canvas} id=${id} class="floor" role="img" aria-label=${label} onClick=${pressed}></canvas>`;
}
