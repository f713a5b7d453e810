// Energy in words: watts now, hours of batteries, and the two savings.
import { html, useEffect, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { known, titleOf } from "./known.js";
import { duration, midnight, nanoseconds, percent } from "./words.js";

const AGAIN_MS = 60_000, MANY = 5;
const sum = (values) => values.reduce((total, value) => total + value, 0);

// Whether figures are of meters, of the model, or of both.
const origin = (measured) => (measured >= 0.995 ? "measured" : measured > 0.005 ? "partly measured" : "modelled");
const wattHours = (j) => (j < 360 ? `${j.toFixed(0)} J` : j >= 3.6e6 ? `${(j / 3.6e6).toFixed(2)} kWh` : `${(j / 3600).toFixed(j < 36_000 ? 1 : 0)} Wh`);
const hours = (h) => (h < 1 ? `${Math.round(60 * h)} min` : h < 100 ? `${h.toFixed(h < 10 ? 1 : 0)} h` : `${Math.round(h / 24)} days`);

function wattsNow(cameras) {
  const online = cameras.filter((camera) => camera.online && camera.power_w != null);
  if (!online.length) return null;
  return { now_w: sum(online.map((camera) => camera.power_w)), measured: sum(online.map((camera) => Number(camera.measured))) / online.length };
}

// One of the two savings, as every page and terminal shows it: a whole percent and its basis.
const saved = (one) => html`${Math.round(Number(one.percent.toFixed(6)))} %) compared with all cameras always active. ${one.basis === "measured" ? "Measured" : "Modelled"}.`;

function Saved() {
  const [today, setToday] = useState(null), { stored, slots_per_s, fps } = known.room;
  useEffect(() => {
    if (!stored) return undefined;
    const look = () => document.hidden || ask(`/api/spent?start=${nanoseconds(midnight())}&end=${nanoseconds(Date.now() / 1000)}`).then((found) => setToday(found.whole_camera), () => setToday(null));
    look();
    const timer = setInterval(look, AGAIN_MS);
    return () => clearInterval(timer);
  }, []);
  const { whole_camera, processor_time } = known.told?.saved || {}, whole = today || whole_camera;
  const joules = (one) => ((one.always - one.spent) * fps) / slots_per_s; // of real seconds
  return html`${whole && html`<p id="saved">${today ? "Saved today" : "Saved since the start"}, whole camera: ${wattHours(joules(whole))} (${saved(whole)}</p>`}
    ${processor_time && html`<p id="saved-cpu">Saved since the start, processor time: ${duration(processor_time.always - processor_time.spent)} (${saved(processor_time)}</p>`}`;
}

// The hours that a battery lasts at the present power; null on mains or where unknown.
/** @param {import("./camera_status.js").CameraStatus} camera */
function leftHours(camera) {
  const capacity_wh = known.room.battery_wh[known.room.cameras.indexOf(camera.camera_id)];
  return camera.battery == null || !camera.power_w || !capacity_wh ? null : (camera.battery * capacity_wh) / camera.power_w;
}

function Batteries({ cameras }) {
  const left = cameras.map((camera) => [camera, leftHours(camera)]).filter(([, h]) => h !== null).sort((a, b) => a[1] - b[1]);
  if (!left.length) return null;
  const words = ([camera, h]) => `${titleOf(camera.camera_id)} ${hours(h)} (${percent(camera.battery)}${camera.gauge ? ", measured" : ", modelled"})`;
  const more = left.length > MANY ? ` and ${left.length - MANY} that last longer` : "";
  return html`<div><dt>batteries last at this power</dt><dd id="batteries" class="list">${left.slice(0, MANY).map(words).join(", ")}${more}</dd></div>`;
}

export function Energy() {
  const cameras = known.told?.cameras || [], now = wattsNow(cameras);
  return html`<section id="energy" aria-labelledby="energy-title"><h2 id="energy-title">Energy</h2><dl>
    <div><dt>cameras now, ${now ? origin(now.measured) : "unknown"}</dt>
      <dd><span id="power">${now ? `${now.measured < 0.995 ? "about " : ""}${now.now_w.toFixed(1)} W` : "–"}</span></dd></div>
    <${Batteries} cameras=${cameras.filter((camera) => camera.online)} />
  </dl><${Saved} /></section>`;
}
