// The page over sites: what needs somebody stands first; figures per group and site.
import { html, render } from "./vendor/preact.js";
import { ask } from "./connection.js";
import { ago, causeWords, duration, number, percent, plural } from "./words.js";

const AGAIN_MS = 15_000, OLD_MS = 60_000;
const WORDS = { well: "well", trouble: "trouble", silent: "silent" };
const RANK = { silent: 0, trouble: 1, well: 2 };
const FAULTS = { "camera-lost": "lost", "camera-useless": "sees nothing", "camera-short": "short of energy", "camera-moved": "moved", "store-full": "disk full", "store-trouble": "cannot store", "record-trouble": "cannot record", stalled: "stalled" };
const root = document.getElementById("page");
const shown = { found: null, at: 0, problem: "", said: "", words: "", group: "", trouble: false };
const sum = (values) => values.reduce((total, value) => total + value, 0);
const known = (sites, name) => sites.map((site) => site[name]).filter((value) => value != null);

function faultWords(fault) {
  const [kind, ...camera] = fault.split(" ");
  return `${camera.length ? `${camera.join(" ")} ` : ""}${FAULTS[kind] || causeWords(kind)}`;
}

// What people did, as the site counted it: "fall begun" is a fall.
function eventWords(events, most = 3) {
  const people = Object.entries(events || {}).filter(([kind]) => kind.endsWith(" begun")).sort((a, b) => b[1] - a[1]);
  const words = people.slice(0, most).map(([kind, count]) => `${kind.replace(" begun", "").replaceAll("-", " ")}${count > 1 ? ` × ${count}` : ""}`);
  return words.join(", ") + (people.length > most ? ", …" : "");
}

function together(sites) {
  const watts = known(sites, "watts"), people = known(sites, "people"), left = known(sites, "hours_left"), events = {};
  for (const site of sites) for (const [kind, count] of Object.entries(site.events || {})) events[kind] = (events[kind] || 0) + count;
  const blind = known(sites, "blind");
  return {
    needs: sites.filter((site) => site.state !== "well").length,
    people: people.length ? sum(people) : null,
    watts: watts.length ? sum(watts) : null,
    measured: watts.length ? sum(sites.map((site) => (site.watts || 0) * (site.measured || 0))) / Math.max(sum(watts), 1e-9) : null,
    left: left.length ? Math.min(...left) : null,
    blind: blind.length ? sum(blind) / blind.length : null,
    events,
  };
}

const watts = (value) => number(value, value < 100 ? 1 : 0, " W");
const hours = (value) => (value == null ? "–" : duration(3600 * value));
const people = (value) => (value == null ? "–" : number(value, value < 10 && value % 1 ? 1 : 0));
const origin = (share) => (share == null ? "" : share > 0.995 ? "measured" : share > 0.005 ? "partly measured" : "modelled");

async function go(site) {
  try {
    location.assign((await ask("/api/open", { site })).url);
  } catch (error) {
    shown.said = `${site}: ${error.message}`;
    draw();
  }
}

function Figures({ sites }) {
  const all = together(sites);
  const figures = [
    ["Sites", String(sites.length), all.needs ? `${plural(all.needs, "site")} to look at` : "all well"],
    ["People now", people(all.people), ""],
    ["Power", watts(all.watts), origin(all.measured)],
    ["First battery empty in", hours(all.left), ""],
    ["Blind slots", percent(all.blind), ""],
    ["Events, 24 h", eventWords(all.events) || "none", ""],
  ];
  return html`<section id="figures" aria-label="All sites"><dl>${figures.map(([name, value, more]) => html`<div key=${name}><dt>${name}${more && ` · ${more}`}</dt><dd>${value}</dd></div>`)}</dl></section>`;
}

function Choice({ groups }) {
  const set = (name) => (event) => {
    shown[name] = event.target.type === "checkbox" ? event.target.checked : event.target.value;
    draw();
  };
  return html`<form id="choice" onSubmit=${(event) => event.preventDefault()}>
    <label>Find <input type="search" id="find" value=${shown.words} onInput=${set("words")} placeholder="name of a site" /></label>
    ${groups.length > 1 && html`<label>Group <select id="group" value=${shown.group} onChange=${set("group")}><option value="">all</option>${groups.map((name) => html`<option key=${name} value=${name}>${name || "no group"}</option>`)}</select></label>`}
    <label class="check"><input type="checkbox" id="trouble" checked=${shown.trouble} onChange=${set("trouble")} /> Only sites to look at</label>
  </form>`;
}

// Why a site is to be looked at, in words.
function why(site, now_s) {
  if (site.state === "silent") {
    const since = site.heard_ns ? `answered ${ago(now_s - site.heard_ns / 1e9)}` : "never answered";
    const problem = site.problem.startsWith(`${site.site}: `) ? site.problem.slice(site.site.length + 2) : site.problem;
    return [problem && problem !== "never asked" ? problem : "nothing new", since].join(", ");
  }
  const most = 3, words = site.faults.slice(0, most).map(faultWords);
  if (site.faults.length > most) words.push(`${site.faults.length - most} more`);
  if (site.state === "trouble" && !words.length) words.push(site.blind == null ? "no slots" : `${percent(site.blind)} of its slots blind`);
  return words.join(", ");
}

function Site({ site, role, now_s }) {
  const old = site.state === "silent" ? "old" : "";
  return html`<tr class=${old}><th scope="row">${site.site}</th>
    <td><b class=${`state ${site.state}`}>${WORDS[site.state]}</b></td>
    <td data-head="people">${people(site.people)}</td>
    <td data-head="power" title=${origin(site.measured)}>${watts(site.watts)}</td>
    <td data-head="hours left">${hours(site.hours_left)}${site.charge != null && html` <small>${percent(site.charge)}</small>`}</td>
    <td data-head="blind">${percent(site.blind)}</td>
    <td data-head="events, 24 h" class="words">${eventWords(site.events) || "–"}</td>
    <td data-head="to look at" class=${`words ${site.state === "well" ? "" : "why"}`}>${why(site, now_s) || "–"}</td>
    <td class="go">${site.page ? html`<button type="button" onClick=${() => go(site.site)} aria-label=${`${role === "operator" ? "Control" : "See"} ${site.site}`}>${role === "operator" ? "Control" : "See"}</button>` : html`<small>no page</small>`}</td></tr>`;
}

function Group({ name, sites, role, now_s }) {
  const all = together(sites);
  return html`<tbody><tr class="group"><th scope="rowgroup">${name || "No group"}</th>
    <td>${all.needs ? html`<b class="state trouble">${all.needs} of ${sites.length}</b>` : html`<b class="state well">${plural(sites.length, "site")}</b>`}</td>
    <td data-head="people">${people(all.people)}</td><td data-head="power">${watts(all.watts)}</td><td data-head="hours left">${hours(all.left)}</td>
    <td data-head="blind">${percent(all.blind)}</td><td data-head="events, 24 h" class="words">${eventWords(all.events) || "–"}</td><td></td><td></td></tr>
    ${sites.map((site) => html`<${Site} key=${site.site} site=${site} role=${role} now_s=${now_s} />`)}</tbody>`;
}

function notice() {
  if (shown.problem) return `${shown.problem}. What is shown is of ${ago((Date.now() - shown.at) / 1000)}.`;
  return shown.said || (Date.now() - shown.at > OLD_MS ? `What is shown is of ${ago((Date.now() - shown.at) / 1000)}.` : "");
}

function Page() {
  const { user, role, now_ns, sites } = shown.found, groups = [...new Set(sites.map((site) => site.group))].sort();
  const wanted = shown.words.trim().toLowerCase(), text = notice();
  const chosen = sites.filter((site) => site.site.toLowerCase().includes(wanted) && (!shown.group || site.group === shown.group) && (!shown.trouble || site.state !== "well"));
  chosen.sort((a, b) => RANK[a.state] - RANK[b.state] || a.site.localeCompare(b.site, undefined, { numeric: true }));
  const needs = together(sites).needs;
  return html`<header><h1>Sites</h1><b id="state" class=${`pill ${needs ? "off" : "live"}`}>${needs ? `${needs} to look at` : "all well"}</b>
      <span class="count soft">${user}, ${role}</span></header>
    <div role="status"><p id="notice" class="notice" hidden=${!text}>${text}</p></div>
    <main class="sites"><${Figures} sites=${sites} /><section aria-label="Sites"><${Choice} groups=${groups} />
      ${chosen.length ? html`<div class="scroll"><table id="table"><thead><tr><th scope="col">Site</th><th scope="col">State</th><th scope="col">People</th><th scope="col">Power</th><th scope="col">Hours left</th><th scope="col">Blind</th><th scope="col" class="words">Events, 24 h</th><th scope="col" class="words">To look at</th><th scope="col"><span class="hidden">Live page</span></th></tr></thead>
        ${groups.map((name) => [name, chosen.filter((site) => site.group === name)]).filter(([, found]) => found.length).map(([name, found]) => html`<${Group} key=${name} name=${name} sites=${found} role=${role} now_s=${now_ns / 1e9} />`)}</table></div>`
      : html`<p class="soft">${sites.length ? "No site is like that." : "No site is in your groups."}</p>`}</section></main>`;
}

function draw() {
  if (shown.found) render(html`<${Page} />`, root);
  else if (shown.problem) render(html`<header><h1>Sites</h1><b id="state" class="pill off">no access</b></header>
    <p id="notice" class="notice" role="alert">${shown.problem}. Open the address with your token, as whoever keeps the hub gave it to you.</p>`, root);
}

async function look() {
  try {
    shown.found = await ask("/api/sites");
    shown.at = Date.now();
    shown.problem = "";
  } catch (error) {
    shown.problem = error.message;
  }
  draw();
}

root.replaceChildren();
look();
setInterval(() => document.hidden || look(), AGAIN_MS);
document.addEventListener("visibilitychange", () => document.hidden || look());
