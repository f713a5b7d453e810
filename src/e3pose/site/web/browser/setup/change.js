// Change a site that exists: goals, zones drawn on the floor, batteries, storage.
import { html, useEffect, useState } from "../vendor/preact.js";
import { Floor } from "./floor.js";
import { busy, order, question, running, setup, shown, turnTo } from "./state.js";

const round = (value) => Math.round(20 * value) / 20; // to five centimetres

// Zones: click corner after corner; a zone is kept when it has a name and three corners.
function Zones({ settings, zones, change }) {
  const [name, type] = useState(""), [corners, put] = useState([]), [typed, typeCorner] = useState("");
  const add = ([x, y]) => put((before) => [...before, [round(x), round(y)]]);
  const fits = /^[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}$/.test(name) && corners.length >= 3 && !zones.some((one) => one.name === name);
  const keep = () => (change([...zones, { name, corners }]), type(""), put([]));
  const byKey = (event) => {
    const found = typed.split(",").map(Number);
    if (event.key !== "Enter" || found.length !== 2 || found.some(Number.isNaN)) return;
    event.preventDefault();
    (add(found), typeCorner(""));
  };
  return html`<fieldset><legend>Zones of the floor</legend>
    <p class="soft">Click the corners of a zone in order, name it, and keep it. Each square is a metre.</p>
    <${Floor} id="zones" bounds=${settings.floor} cameras=${settings.centers} zones=${[...zones, { name, corners, open: true }]} press=${add} label=${`Map of the floor with ${zones.length} zones`} />
    <p class="row"><label>Name <input id="zone-name" value=${name} maxlength="64" placeholder="door" onInput=${(event) => type(event.target.value)} /></label>
      <label>Corner x,y <input id="zone-corner" value=${typed} placeholder="1.5,-2" size="8" onInput=${(event) => typeCorner(event.target.value)} onKeyDown=${byKey} /></label>
      <button type="button" id="keep-zone" disabled=${!fits} onClick=${keep}>Keep the zone (${corners.length} corners)</button>
      <button type="button" disabled=${!corners.length} onClick=${() => put([])}>Begin again</button></p>
    <ul class="found">${zones.map((zone) => html`<li key=${zone.name}><b>${zone.name}</b> <span class="soft">${zone.corners.length} corners</span> <button type="button" aria-label=${`Remove the zone ${zone.name}`} onClick=${() => change(zones.filter((one) => one !== zone))}>Remove</button></li>`)}</ul></fieldset>`;
}

export function Change() {
  const [settings, have] = useState(null), [typed, type] = useState({}), [done, say] = useState(null), [why, complain] = useState("");
  const load = () => question("settings").then((found) => (have(found), type({})), (error) => complain(error.message));
  useEffect(() => void load(), []);
  if (why) return html`<p class="bad">${why}</p>`;
  if (!settings) return html`<p class="soft">…</p>`;
  const value = (key) => typed[key] ?? settings[key] ?? "", keep = (key) => (event) => type((now) => ({ ...now, [key]: event.target.value }));
  const byError = typed.goal ? typed.goal === "error" : Boolean(settings.target_error);
  const save = async (event) => {
    event.preventDefault();
    const wanted = {};
    for (const key of ["budget", "keep", "max_size", "zones", "batteries"]) if (typed[key] !== undefined) wanted[key] = typed[key];
    if (byError && (typed.goal || typed.target_error !== undefined)) wanted.target_error = value("target_error");
    if (!byError && (typed.goal || typed.cameras !== undefined)) wanted.cameras = Number(value("cameras")) || 1;
    const found = await order("settings", wanted);
    if (found) await load(); // before it is said: what is typed from then on stays
    say(found);
  };
  const back = async () => {
    const found = await order("settings/before");
    await load();
    say(found);
  };
  const restart = async () => {
    await order("live", { order: "restart" });
    say({ said: "The site starts again with its new settings.", restart: false });
    shown();
  };
  const batteries = typed.batteries || settings.batteries, off = busy();
  const text = (key, words, hint, help) => html`<label>${words} <input id=${key} value=${value(key)} maxlength="60" placeholder=${hint} onInput=${keep(key)} /></label><p class="soft">${help}</p>`;
  return html`<p>Changes are checked, then written to <code>site.toml</code>; the file of before is kept. Cameras and network: in <button type="button" class="plain" onClick=${() => turnTo("cameras")}>their steps</button>.</p>
    ${done && html`<p id="said" class="notice" role="status">${done.said} ${done.restart && running() && html`<button type="button" id="restart" onClick=${restart}>Restart now</button>`}</p>`}
    <form id="settings" onSubmit=${save}>
      <fieldset><legend>Goal</legend>
        <label class="row"><input type="radio" name="goal" checked=${!byError} onChange=${() => type((now) => ({ ...now, goal: "cameras" }))} /> Active cameras per slot <input id="cameras-count" type="number" min="0.5" max=${settings.most} step="0.5" aria-label="Active cameras per slot" value=${value("cameras") || 2} disabled=${byError} onInput=${keep("cameras")} /></label>
        <label class="row"><input type="radio" name="goal" id="by-error" checked=${byError} onChange=${() => type((now) => ({ ...now, goal: "error" }))} /> As few as keep the error below <input id="target_error" aria-label="Error to keep below" value=${value("target_error")} placeholder="40mm" maxlength="20" disabled=${!byError} onInput=${keep("target_error")} /></label>
        ${text("budget", "Budget of each camera", "4W", "such as 60%, 4W, or until 18:00; empty for the usual one")}</fieldset>
      <fieldset><legend>Batteries, Wh</legend><p class="soft">0 for mains.</p>
        ${Object.keys(settings.batteries).map((name) => html`<label key=${name}>${name} <input type="number" min="0" step="any" value=${batteries[name]} onInput=${(event) => type((now) => ({ ...now, batteries: { ...batteries, [name]: Number(event.target.value) || 0 } }))} /></label>`)}</fieldset>
      ${settings.stored && html`<fieldset><legend>Storage</legend>${text("keep", "Keep poses for", "30d", "older ones are deleted; empty for ever")}${text("max_size", "Largest size", "20GB", "the oldest go first; empty for no limit")}</fieldset>`}
      <${Zones} settings=${settings} zones=${typed.zones || settings.zones} change=${(zones) => type((now) => ({ ...now, zones }))} />
      <p class="row"><button type="submit" id="save" class="main" disabled=${off || !Object.keys(typed).length}>Check and save</button>
      ${settings.before && html`<button type="button" id="before" disabled=${off} onClick=${back}>Restore the previous file</button>`}</p>
    </form>`;
}
