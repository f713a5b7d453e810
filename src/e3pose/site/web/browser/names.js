// What people are called and drawn in. Tracks are numbered anew in each run: names go by both.
import { changed, known } from "./known.js";
import { sceneInks } from "./palette.js";

export const COLOUR_WORDS = ["blue", "orange", "green", "pink", "sky", "gold", "grey", "brown"]; // as the scene's palette has them
const UNCALLED = { name: null, colour: null };
const keyOf = (track, run) => `${run} ${track}`;

// The run whose people are shown.
export const runShown = () => (known.mode === "past" ? known.shown?.run ?? null : known.run);
export const called = (track, run = runShown()) => known.called.get(keyOf(track, run)) || UNCALLED;
export const nameOf = (track, run = runShown()) => called(track, run).name || `Person ${track}`;

// Who somebody is among all runs: the name, or the track of a run.
export const whoIs = (track, run = runShown()) => called(track, run).name ?? keyOf(track, run);

export function colourOf(track, run = runShown()) {
  const { colours } = sceneInks(), chosen = COLOUR_WORDS.indexOf(called(track, run).colour);
  return colours[chosen >= 0 ? chosen : ((track % colours.length) + colours.length) % colours.length];
}

// Take over what tracks are called: of all tracks of `run` where one is given, those not listed have no name.
export function learnNames(tracks, run = null) {
  if (run !== null) for (const key of known.called.keys()) if (key.startsWith(`${run} `)) known.called.delete(key);
  for (const { run: of, track, name, colour } of tracks) {
    if (name || colour) known.called.set(keyOf(track, of), { name, colour });
    else known.called.delete(keyOf(track, of));
  }
  changed();
}

export const ofRow = (row) => ({ run: row.run_id, track: row.track_id, name: row.name, colour: row.colour });
