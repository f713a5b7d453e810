// The list of what people did, newest first; what goes on stands out, and is announced.
import { html } from "./vendor/preact.js";
import { known } from "./known.js";
import { ALARMS, goesOn, occurrences, sentence } from "./happened.js";
import { seek } from "./past.js";

const SHOWN = 60;

// Events up to the moment that is shown.
export function upToNow() {
  const t = known.mode === "past" ? known.shown?.t ?? -Infinity : Infinity;
  return occurrences().filter((one) => one.told_s <= t);
}

export function Events() {
  const now_s = known.mode === "live" ? known.shown?.t ?? Date.now() / 1000 : Date.now() / 1000;
  const shown = upToNow().slice(-SHOWN).reverse(), { stored, tells } = known.room;
  const urgent = shown.filter((one) => ALARMS.has(one.kind) && goesOn(one) && known.mode === "live");
  const none = tells ? "Nothing so far." : "Events are off. Add [events] to site.toml to turn them on.";
  return html`<section aria-labelledby="events-title"><h2 id="events-title">What happened</h2>
    <p class="hidden" role="alert">${urgent.map((one) => sentence(one, one.told_s)).join(". ")}</p>
    <ol id="happened" class="events" tabindex="0" aria-label="What happened, newest first">
      ${shown.length ? shown.map((one) => html`<li key=${`${one.kind} ${one.track} ${one.start_s}`} class=${urgent.includes(one) ? "alarm" : ALARMS.has(one.kind) ? "grave" : ""}>
        <span>${sentence(one, now_s)}</span>
        ${stored && html`<button type="button" class="plain" aria-label=${`Show: ${sentence(one, one.told_s)}`} onClick=${() => seek(one.start_s - 5)}>Show</button>`}
      </li>`) : html`<li class="soft">${none}</li>`}
    </ol></section>`;
}
