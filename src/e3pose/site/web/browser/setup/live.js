// Go live: the programs of the site run as `e3pose up --view` runs them, and the live page opens.
import { html } from "../vendor/preact.js";
import { busy, order, running, setup } from "./state.js";

export function GoLive() {
  const { live, site } = setup.state, on = running();
  const people = live.people === null ? "" : live.people === 0 ? "Nobody is in view." : live.people === 1 ? "One person is in view." : `${live.people} people are in view.`;
  return html`<p>This starts the edge and one program per camera. The site runs until you stop it here or end <code>e3pose setup</code>; later start it with the command beside.</p>
    <p class="row">${on
      ? html`<button type="button" id="live-stop" disabled=${live.state === "ending"} onClick=${() => order("live", { order: "stop" })}>${live.state === "ending" ? "Stopping …" : "Stop the site"}</button>`
      : html`<button type="button" id="live-start" class="main" disabled=${busy()} onClick=${() => order("live", { order: "start" })}>Go live</button>`}
      ${live.state === "running" && html`<a id="live-page" class=${live.live ? "button main" : "button"} href=${live.url} target="_blank" rel="noopener">Open the live page</a>`}</p>
    <p id="live-words" role="status">${live.state === "starting" ? "Starting: measuring and checking the site …" : live.words || (live.live ? `${site} is live. ${people}` : on ? "" : "The site is off.")}</p>
    ${live.problem && html`<p class="notice" role="alert">${live.problem}</p>`}
    ${live.lines.map((line) => html`<p class="unsure">${line}</p>`)}`;
}
