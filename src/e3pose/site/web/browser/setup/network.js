// Network: which detectors are there, how fast they are here, and which one the site uses.
import { html, useEffect, useState } from "../vendor/preact.js";
import { busy, order, question, running, setup, stepOf, turnTo } from "./state.js";

function Row({ network, chosen, off }) {
  const { name, title, licence, mb, installed, speed } = network, path = `networks/${encodeURIComponent(name)}`;
  return html`<li class=${`network ${chosen ? "chosen" : ""}`}><h3>${name} ${chosen && html`<span class="pill live">in use</span>`}</h3>
    <p>${title}</p>
    <p class="soft">Licence: ${licence}${mb ? ` · ${mb} MB` : ""} · ${installed ? "on this machine" : "not downloaded"}</p>
    ${speed && html`<p class="speed">${speed}</p>`}
    <p class="row">${installed
      ? html`<button type="button" class="main" id=${`use-${name}`} disabled=${off} onClick=${() => order(`${path}/use`)}>${chosen ? "Measure and use again" : "Use this one"}</button>
        <button type="button" disabled=${off} aria-label=${`Measure ${name}`} onClick=${() => order(`${path}/time`)}>Measure</button>`
      : html`<button type="button" disabled=${busy()} onClick=${() => order(`${path}/pull`)}>Download<span class="hidden"> ${name}</span>${mb ? ` ${mb} MB` : ""}</button>`}</p></li>`;
}

export function Network() {
  const [networks, list] = useState(null), { detector } = setup.state, step = stepOf("network"), off = busy() || running();
  useEffect(() => {
    if (!busy()) question("networks").then(list, () => {});
  }, [busy()]);
  if (!networks) return html`<p class="soft">…</p>`;
  const first = networks.filter((one) => one.usual || one.installed), rest = networks.filter((one) => !first.includes(one));
  const rows = (some) => html`<ul class="networks">${some.map((one) => html`<${Row} key=${one.name} network=${one} chosen=${step.done && one.name === detector} off=${off} />`)}</ul>`;
  return html`<p>A network finds people in each picture. Using one measures it with all your cameras and writes <code>site.toml</code> with as many moments a second as this machine reaches.</p>
    ${step.done && html`<p><button type="button" id="next" class="main" disabled=${busy()} onClick=${() => turnTo("walk")}>Next: the walk</button></p>`}
    ${rows(first)}${rest.length > 0 && html`<details><summary>More networks</summary>${rows(rest)}</details>`}`;
}
