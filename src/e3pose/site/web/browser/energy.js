// Energy in words: watts now, what today saved against all cameras always looking, hours of batteries.
import { html, useEffect, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { known } from "./known.js";
import { midnight, nanoseconds, percent } from "./words.js";

const AGAIN_MS = 60_000, MANY = 5;
const sum = (values) => values.reduce((total, value) => total + value, 0);

// Whether figures are of meters, of the model, or of both.
const origin = (measured) => (measured >= 0.995 ? "measured" : measured > 0.005 ? "partly measured" : "modelled");
const wattHours = (j) => (j >= 3.6e6 ? `${(j / 3.6e6).toFixed(2)} kWh` : `${(j / 3600).toFixed(j < 36_000 ? 1 : 0)} Wh`);
const hours = (h) => (h < 1 ? `${Math.round(60 * h)} min` : h < 100 ? `${h.toFixed(h < 10 ? 1 : 0)} h` : `${Math.round(h / 24)} days`);

export function wattsNow(cameras) {
  const online = cameras.filter((camera) => camera.online && camera.power_w != null), room = known.room;
  if (!online.length) return null;
  const always_w = sum(online.map((camera) => room.active_w[room.cameras.indexOf(camera.camera_id)] ?? 0));
  return { now_w: sum(online.map((camera) => camera.power_w)), always_w, measured: sum(online.map((camera) => Number(camera.measured))) / online.length };
}

function Today() {
  const [spent, setSpent] = useState(null);
  useEffect(() => {
    if (!known.room.stored) return undefined;
    const look = () => document.hidden || ask(`/api/spent?start=${nanoseconds(midnight())}&end=${nanoseconds(Date.now() / 1000)}`).then(setSpent, () => setSpent(null));
    look();
    const timer = setInterval(look, AGAIN_MS);
    return () => clearInterval(timer);
  }, []);
  const rows = (spent?.cameras || []).filter((one) => known.room.cameras.includes(one.camera_id) && one.span_s > 0);
  if (!rows.length) return null;
  const span_s = sum(rows.map((one) => one.span_s)), spent_j = sum(rows.map((one) => one.energy_j));
  const always_j = sum(rows.map((one) => one.span_s * known.room.active_w[known.room.cameras.indexOf(one.camera_id)]));
  const measured = sum(rows.map((one) => one.measured * one.span_s)) / span_s, saved_j = always_j - spent_j;
  return html`<div><dt>${saved_j < 0 ? "more today than with" : "saved today against"} all cameras always looking (modelled)</dt>
    <dd id="saved">${wattHours(Math.abs(saved_j))} <small>${percent(Math.abs(saved_j) / always_j)}, of ${wattHours(always_j)}; spent ${wattHours(spent_j)}, ${origin(measured)}</small></dd></div>`;
}

// The hours that a battery lasts at the present power; null on mains or where unknown.
function leftHours(camera) {
  const capacity_wh = known.room.battery_wh[known.room.cameras.indexOf(camera.camera_id)];
  return camera.battery == null || !camera.power_w || !capacity_wh ? null : (camera.battery * capacity_wh) / camera.power_w;
}

function Batteries({ cameras }) {
  const left = cameras.map((camera) => [camera, leftHours(camera)]).filter(([, h]) => h !== null).sort((a, b) => a[1] - b[1]);
  if (!left.length) return null;
  const words = ([camera, h]) => `${camera.camera_id} ${hours(h)} (${percent(camera.battery)}${camera.gauge ? ", measured" : ", modelled"})`;
  const more = left.length > MANY ? ` and ${left.length - MANY} that last longer` : "";
  return html`<div><dt>batteries last at this power</dt><dd id="batteries" class="list">${left.slice(0, MANY).map(words).join(", ")}${more}</dd></div>`;
}

export function Energy() {
  const cameras = known.told?.cameras || [], now = wattsNow(cameras);
  const saved = now && now.always_w > 0 ? 1 - now.now_w / now.always_w : null;
  return html`<section id="energy" aria-labelledby="energy-title"><h2 id="energy-title">Energy</h2><dl>
    <div><dt>cameras now, ${now ? origin(now.measured) : "unknown"}</dt>
      <dd><span id="power">${now ? `${now.measured < 0.995 ? "about " : ""}${now.now_w.toFixed(1)} W` : "–"}</span> ${saved !== null && saved > 0.005 && html`<small>${percent(saved)} less than all looking</small>`}</dd></div>
    <${Today} />
    <${Batteries} cameras=${cameras.filter((camera) => camera.online)} />
  </dl></section>`;
}
