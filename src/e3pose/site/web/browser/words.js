// Words for what the page shows: times, postures, cameras, watts. Plain sentences, no codes.

export const number = (value, places = 0, unit = "") => (value === null || value === undefined ? "–" : value.toFixed(places) + unit);
export const percent = (value) => (value === null || value === undefined ? "–" : `${Math.round(100 * value)} %`);
export const plural = (count, one) => `${count} ${one}${count === 1 ? "" : "s"}`;

export const nanoseconds = (seconds) => `${Math.round(seconds * 1000)}000000`;
export const midnight = (t = Date.now() / 1000) => new Date(1000 * t).setHours(0, 0, 0, 0) / 1000;
const sameDay = (a, b) => a.toDateString() === b.toDateString();

// A time of day, with the day if it is another one than today.
export function clock(t) {
  const when = new Date(1000 * t), time = when.toLocaleTimeString();
  return sameDay(when, new Date()) ? time : `${when.toLocaleDateString()} ${time}`;
}

// The same in hours and minutes, as people say it.
export function hourOf(t) {
  const when = new Date(1000 * t), time = when.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  return sameDay(when, new Date()) ? time : `${when.toLocaleDateString([], { day: "numeric", month: "short" })}, ${time}`;
}

export function duration(s) {
  if (s < 60) return `${Math.max(0, Math.round(s))} s`;
  if (s < 5400) return `${Math.round(s / 60)} min`;
  const hours = Math.floor(s / 3600), minutes = Math.round((s - 3600 * hours) / 60);
  return s < 36_000 && minutes ? `${hours} h ${minutes} min` : s < 172_800 ? `${Math.round(s / 3600)} h` : plural(Math.round(s / 86_400), "day");
}
export const ago = (s) => `${duration(s)} ago`;

export const bytesWords = (bytes) => (bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1000))} kB` : bytes < 1e9 ? `${(bytes / 1e6).toFixed(1)} MB` : `${(bytes / 1e9).toFixed(1)} GB`);

export const CAUSES = { "orders-late": "orders late", "views-late": "views late", "views-missing": "views missing", "cameras-offline": "no camera online" };
export const causeWords = (cause) => CAUSES[cause] || cause;

// ---- people

const POSTURES = {
  standing: "Standing", walking: "Walking", sitting: "Sitting", bending: "Bending", crouching: "Crouching", crawling: "Crawling", lying: "Lying",
};
const LIKELY = 0.7; // less probable postures are only probably so

export function posture({ state, probability }) {
  if (!state) return "";
  if (state === "unknown") return "Posture uncertain";
  return probability < LIKELY ? `Probably ${state}` : POSTURES[state] || state;
}

const RAISED = ["", "an arm up", "both arms up"];
const speed = (speed_mps) => (speed_mps == null ? "" : speed_mps < 0.15 ? "not moving" : `${speed_mps.toFixed(1)} m/s`);
export const moves = ({ speed_mps, arms_raised }) => [speed(speed_mps), RAISED[arms_raised]].filter(Boolean).join(", ");
export const article = (zone) => (/^(the|a|an|my) /i.test(zone) ? zone : `the ${zone}`);

// In which zones, since when; else how long in view.
export function whereabouts({ zones, since_ns }, now_s) {
  const stays = (zones || []).map(({ name, since_ns: entered }) => `in ${article(name)} for ${duration(now_s - entered / 1e9)}`);
  return stays.length ? stays.join(", ") : since_ns ? `in view for ${duration(now_s - since_ns / 1e9)}` : "";
}

export function unsureWords({ unsure }) {
  if (!unsure || !unsure.length) return "";
  const limbs = ["arm", "leg"].flatMap((limb) => {
    const sides = ["left", "right"].filter((side) => unsure.includes(`${side} ${limb}`));
    return sides.length === 2 ? [`both ${limb}s`] : sides.map((side) => `${side} ${limb}`);
  });
  const parts = [...(unsure.includes("head") ? ["head"] : []), ...limbs];
  return `${parts.length > 1 ? `${parts.slice(0, -1).join(", ")} and ${parts.at(-1)}` : parts[0]} uncertain`;
}

// ---- cameras

export const sleeps = (camera) => camera.asleep_s != null && camera.asleep_s > -2 && !camera.online && !camera.paused;

/** @param {import("./camera_status.js").CameraStatus} camera */
export function cameraWords(camera) {
  if (!camera) return "";
  if (camera.paused) return "paused";
  if (sleeps(camera)) return camera.asleep_s > 1 ? `asleep, back in ${duration(camera.asleep_s)}` : "waking up";
  if (!camera.online) return "offline";
  return { active: "active", "power-saving": "idle", "aggressive-power-saving": "idle" }[camera.mode] || "connected";
}

// Why it is not as it should be.
export const complaint = (camera) => (camera && camera.why && !sleeps(camera) ? camera.why : "");
