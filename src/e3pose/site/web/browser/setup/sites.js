// The first screen: go on with a site, begin a new one, or open a finished example.
import { html, useState } from "../vendor/preact.js";
import { order, setup } from "./state.js";

export function Sites() {
  const { sites, root } = setup.state, [name, type] = useState(sites.some((one) => one.name === "room") ? "" : "room");
  const create = (kind) => (event) => {
    event.preventDefault();
    order("site", { name: name.trim(), kind });
  };
  return html`<div class="choices">
    ${setup.error && html`<p id="error" class="notice" role="alert">${setup.error}</p>`}
    <h2>A new site</h2>
    <p>A site is a folder with the settings of your cameras. It is made in <code>${root}</code>.</p>
    <form onSubmit=${create("new")}><label class="row">Name <input id="name" value=${name} maxlength="64" required autocomplete="off" pattern="[A-Za-z0-9_][A-Za-z0-9_.\\-]*" title="letters, digits, - _ ." onInput=${(event) => type(event.target.value)} /></label>
      <p class="row"><button type="submit" id="create" class="main" disabled=${!name.trim()}>Set up cameras</button>
      <button type="button" id="example" disabled=${!name.trim()} onClick=${create("example")}>See a finished example</button></p></form>
    ${sites.length > 0 && html`<h2>Go on with a site</h2><ul id="sites">${sites.map((one) => html`<li key=${one.name}><button type="button" onClick=${() => order("site", { name: one.name })}>${one.name}</button>
      <span class="soft">${one.made ? "change cameras, goals, zones, storage; or start it" : "begun, no site file yet"}</span></li>`)}</ul>`}
  </div>`;
}
