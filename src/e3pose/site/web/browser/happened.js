// What people did: events as they are told live and as they are stored, put together to occurrences,
// in sentences. An occurrence that goes on says so, and for how long.
import { changed, known } from "./known.js";
import { nameOf } from "./names.js";
import { article, duration, hourOf } from "./words.js";

export const ALARMS = new Set(["fall", "on-floor"]);
const LOST_S = 600; // so long whoever fell and is not seen any more is shown as an alarm
const SAME_S = 3; // edge and page see a start so far apart at most
const FALL_S = 10; // lying on the floor begins so near to the start of the fall that led there
const KEPT = 2000;
const NOBODY = -1;

// Add events, as the stream or the store have them; what is known is not added again.
export function learn(events, how) {
  for (const event of events) {
    const start_s = (event.start_ns ?? event.time_ns) / 1e9, told_s = event.time_ns / 1e9;
    const track = event.track ?? event.track_id, run = event.run_id ?? known.run, here = known.happened;
    const like = here.findLast((one) => one.kind === event.kind && one.track === track && Math.abs(one.start_s - start_s) < SAME_S);
    const one = like || { kind: event.kind, track, start_s, told_s, end_s: null, zone: event.zone || "", score: event.score, text: event.sentence || event.message, run, live: false };
    if (how === "live") one.live = true;
    one.run ??= run;
    if (event.phase === "ended") one.end_s = told_s;
    one.told_s = Math.min(one.told_s, told_s);
    if (!like) here.push(one);
  }
  known.happened.sort((a, b) => a.told_s - b.told_s);
  known.happened.splice(0, known.happened.length - KEPT);
  changed();
}

// When somebody who fell got up: told by itself, or by the end of lying on the floor; null before.
export function upAt(fall) {
  const up = known.happened.find(
    (one) => one.track === fall.track && ((one.kind === "got-up" && one.told_s > fall.told_s) || (one.kind === "on-floor" && one.end_s && one.end_s > fall.told_s && one.start_s < fall.told_s + 60)),
  );
  return up ? (up.kind === "got-up" ? up.told_s : up.end_s) : null;
}

// What is to be listed: one occurrence for somebody who fell, lay there and got up.
export function occurrences() {
  const falls = known.happened.filter((one) => one.kind === "fall");
  const told = (one) => falls.some((fall) => fall.track === one.track && (one.kind === "on-floor" ? Math.abs(one.start_s - fall.start_s) < FALL_S : one.kind === "got-up" && Math.abs((upAt(fall) ?? Infinity) - one.told_s) < FALL_S));
  return known.happened.filter((one) => !told(one));
}

// Whether an occurrence is of a person of a run; one that was told before the run was known is of that which runs.
export const isOf = (one, track, run) => one.track === track && (one.run ?? known.run) === run;
const seenNow = (one) => known.mode === "live" && known.shown?.people.some((person) => isOf(one, person.track, known.run));

// Whether it goes on as far as the page knows; whoever is not seen any more may still lie there.
export function goesOn(one) {
  const ended = one.kind === "fall" ? upAt(one) !== null : one.end_s !== null;
  return !ended && one.live && (seenNow(one) || (known.shown?.t ?? 0) - one.told_s < LOST_S);
}

const SENTENCES = {
  fall: (one, who, where, now_s) => {
    const up_s = upAt(one), begun = `${who} fell${where} at ${hourOf(one.start_s)}`;
    if (up_s !== null) return `${begun}, got up after ${duration(up_s - one.start_s)}`;
    if (known.mode === "past") return begun;
    return seenNow(one) ? `${begun}, has not got up for ${duration(now_s - one.start_s)}` : `${begun}, was not seen to get up`;
  },
  "on-floor": (one, who, where, now_s) => {
    if (one.end_s !== null) return `${who} was on the floor${where} for ${duration(one.end_s - one.start_s)}, from ${hourOf(one.start_s)}`;
    return seenNow(one) ? `${who} has been on the floor${where} for ${duration(now_s - one.start_s)}` : `${who} was on the floor${where} since ${hourOf(one.start_s)}`;
  },
  "got-up": (one, who, where) => `${who} got up${where} at ${hourOf(one.told_s)}`,
  left: (one, who) => `${who} left${one.zone ? ` ${article(one.zone)}` : ""} at ${hourOf(one.told_s)}`,
  waved: (one, who, where) => `${who} waved${where} at ${hourOf(one.start_s)}`,
  nobody: (one) => (one.end_s === null ? `Nobody seen since ${hourOf(one.start_s)}` : `Nobody was seen from ${hourOf(one.start_s)} to ${hourOf(one.end_s)}`),
  "too-many": (one) => (one.end_s === null ? `Too many people since ${hourOf(one.start_s)}` : `Too many people from ${hourOf(one.start_s)} to ${hourOf(one.end_s)}`),
};

export function sentence(one, now_s = Date.now() / 1000) {
  const made = SENTENCES[one.kind];
  if (!made) return one.text;
  const who = one.track === NOBODY ? "" : nameOf(one.track, one.run ?? known.run);
  return made(one, who, one.zone ? ` near ${article(one.zone)}` : "", now_s);
}

