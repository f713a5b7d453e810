// The people who are there: name, colour, what each does, where and for how long, what is uncertain.
import { html, useState } from "./vendor/preact.js";
import { PersonsDay } from "./day.js";
import { known } from "./known.js";
import { ALARMS, goesOn, isOf } from "./happened.js";
import { colourOf, nameOf, runShown } from "./names.js";
import { moves, posture, unsureWords, whereabouts } from "./words.js";

const alarming = (track) => known.mode === "live" && known.happened.some((one) => isOf(one, track, known.run) && ALARMS.has(one.kind) && goesOn(one));

function Person({ track, does, open }) {
  const now_s = known.shown.t, doing = posture(does), unsure = unsureWords(does);
  const words = [moves(does), whereabouts(does, now_s)].filter(Boolean).join(" · ");
  return html`<li class=${`person ${alarming(track) ? "alarm" : ""}`}>
    <i class="swatch" style=${{ background: colourOf(track) }}></i>
    <button type="button" class="name plain" title="Show the day of this person" onClick=${() => open({ track, run: runShown() })}>${nameOf(track)}</button>
    <b class="doing">${doing}</b>
    ${words && html`<span class="soft">${words}</span>`}
    ${unsure && html`<span class="unsure">${unsure}</span>`}
  </li>`;
}

export function People() {
  const [who, open] = useState(null), people = known.shown ? [...known.shown.people].sort((a, b) => a.track - b.track) : [];
  const none = known.shown ? "Nobody is there." : known.mode === "past" ? "unknown" : "Waiting for the first poses …";
  return html`<section aria-labelledby="people-title"><h2 id="people-title">People</h2>
    <ul id="people">${people.length ? people.map((one) => html`<${Person} key=${one.track} ...${one} open=${open} />`) : html`<li class="soft">${none}</li>`}</ul>
    ${who && html`<${PersonsDay} ...${who} close=${() => open(null)} />`}
  </section>`;
}
