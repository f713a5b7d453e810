// Starts the page of the set-up: its steps, the step that is open, and the work in the background.
import { html, render, useEffect, useState } from "../vendor/preact.js";
import { Cameras } from "./cameras.js";
import { Change } from "./change.js";
import { Check } from "./check.js";
import { GoLive } from "./live.js";
import { Network } from "./network.js";
import { Sites } from "./sites.js";
import { Solve } from "./solve.js";
import { begin, busy, order, running, setup, shown, stepOf, turnTo, whenKnown } from "./state.js";
import { Walk } from "./walk.js";

const root = document.getElementById("page");
const OF = { cameras: "cameras", "network-look": "cameras", pull: "network", timing: "network", site: "network", walk: "walk", solve: "solve", second: "check", check: "check" };
const STEPS = { cameras: Cameras, network: Network, walk: Walk, solve: Solve, check: Check, live: GoLive, change: Change };

function Head() {
  const { site, live } = setup.state, word = setup.lost ? "no connection" : live.state === "running" ? (live.live ? "live" : "starting") : busy() ? "at work" : "";
  return html`<header><h1>${site ? html`Set up <span id="site">${site}</span>` : "Set up a site"}</h1>
    ${word && html`<b id="state" class=${`pill ${setup.lost ? "off" : word === "live" ? "live" : "past"}`}>${word}</b>`}
    ${site && html`<button type="button" id="leave" disabled=${busy() || running()} onClick=${() => order("site/leave")}>Other site</button>`}</header>`;
}

// The steps in their order: which are done, which can begin.
function Steps() {
  return html`<nav aria-label="Steps"><ol id="steps">${setup.state.steps.map(({ id, title, done, open, words }, index) => html`<li key=${id}>
    <button type="button" id=${`to-${id}`} class=${done ? "done" : ""} aria-current=${setup.step === id ? "step" : null} disabled=${!open} onClick=${() => turnTo(id)}>
      <span class="mark" aria-hidden="true">${id === "change" ? "…" : done ? "✓" : index + 1}</span>
      <span>${title}<small>${done && id !== "change" ? html`<span class="hidden">, done: </span>` : ""}${words}</small></span></button></li>`)}</ol></nav>`;
}

// The work in the background; it goes on when this page is closed.
function Work() {
  const { task } = setup.state;
  if (!task || (task.state !== "running" && OF[task.kind] !== setup.step)) return null;
  const running = task.state === "running", since = task.since_s < 90 ? `${Math.round(task.since_s)} s` : `${Math.round(task.since_s / 60)} min`;
  const words = running ? `${task.title}: ${task.stopping ? "stopping …" : task.stage || "…"}` : { done: `${task.title}: done after ${since}.`, stopped: `${task.title}: stopped.`, failed: `${task.title} failed.` }[task.state];
  return html`<section id="work" class=${task.state} aria-label="Work in the background">
    <p id="work-words" role="status">${words}</p>
    ${running && html`<span class="soft">${since}</span>`}
    ${running && html`<progress aria-label=${task.title} max=${task.total || 1} value=${task.total ? task.done : null}></progress>
      ${!["walk", "second"].includes(task.kind) && html`<button type="button" id="stop" disabled=${task.stopping} onClick=${() => order("stop")}>Stop</button>`}`}
    ${task.problem && html`<p id="problem" class="bad" role="alert">${task.problem}</p>`}
    ${task.lines.map((line) => html`<p class="soft">${line}</p>`)}
  </section>`;
}

// The command line that does the same, to be copied.
function Command({ text }) {
  const [copied, copy] = useState(false);
  useEffect(() => copy(false), [text]);
  const put = () => navigator.clipboard.writeText(text).then(() => copy(true), () => copy(false));
  return html`<aside class="command" aria-label="The same on the command line"><h2>The same on the command line</h2>
    <pre id="command" tabindex="0">${text}</pre>
    <p class="soft">Run it in <code>${setup.state.root}</code></p>
    <button type="button" onClick=${put}>${copied ? "Copied" : "Copy"}</button></aside>`;
}

function Page() {
  const { site } = setup.state, step = stepOf(setup.step), Step = STEPS[setup.step];
  return html`<${Head} />
    ${setup.lost && html`<p class="notice" role="alert">No connection to e3pose setup: it was stopped. Start it again in the same folder and open the address that it prints; it goes on where it was.</p>`}
    ${!site && html`<main class="setup alone"><section><${Work} /><${Sites} /></section></main>`}
    ${site && step && html`<main class="setup"><${Steps} />
      <section id="step" aria-labelledby="step-title"><h2 id="step-title" tabindex="-1">${step.title}</h2>
        ${setup.error && html`<p id="error" class="notice" role="alert">${setup.error}</p>`}
        <${Work} /><${Step} key=${`${site} ${step.id}`} /></section>
      <${Command} text=${step.command} /></main>`}`;
}

async function start() {
  try {
    await begin();
  } catch (error) {
    render(html`<header><h1>e3pose</h1><b id="state" class="pill off">no access</b></header>
      <p id="notice" class="notice" role="alert">${error.message}. Open the whole address that e3pose setup printed, with the token.</p>`, root);
    return;
  }
  root.replaceChildren();
  const draw = () => {
    document.title = `${setup.state.site ? `${setup.state.site} · ` : ""}Set up · e3pose`;
    render(html`<${Page} />`, root);
  };
  whenKnown(draw);
  shown();
}

start();
