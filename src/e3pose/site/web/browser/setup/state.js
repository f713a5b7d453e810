// What the set-up knows: the server has it all, the page asks again and again and shows it.
import { ask } from "../connection.js";

const BUSY_MS = 500, IDLE_MS = 2000;
export const setup = { state: null, step: "", error: "", said: "", lost: false };
const listeners = [];
let orders = 0;  // begun or answered: what was asked before says how things were

export const whenKnown = (listener) => listeners.push(listener);
export const shown = () => listeners.forEach((listener) => listener());

export const busy = () => setup.state?.task?.state === "running";
export const taskOf = (...kinds) => (kinds.includes(setup.state?.task?.kind) ? setup.state.task : null);
export const stepOf = (id) => setup.state?.steps?.find((one) => one.id === id);
export const running = () => ["starting", "running", "ending"].includes(setup.state?.live.state);

// Turn to a step; the address remembers it for a reload.
export function turnTo(id) {
  Object.assign(setup, { step: id, error: "", said: "" });
  history.replaceState(null, "", `#${id}`);
  shown();
  document.getElementById("step-title")?.focus({ preventScroll: false });
}

// Where to begin: the step of the address, else the first that is not done.
export function firstStep() {
  const steps = setup.state.steps || [], named = location.hash.slice(1);
  if (steps.some((one) => one.id === named)) return named;
  return (steps.find((one) => one.open && !one.done) || steps[0])?.id || "";
}

function take(state) {
  const other = state.site !== setup.state?.site;
  setup.state = state;
  if (!other) return;
  setup.step = state.site ? firstStep() : "";
  history.replaceState(null, "", setup.step ? `#${setup.step}` : location.pathname);
}

export async function order(path, body = {}) {
  Object.assign(setup, { error: "", said: "" });
  orders++;
  try {
    const found = await ask(`/api/setup/${path}`, body);
    orders++;
    if (found?.live) take(found);
    else await refresh();
    return found;
  } catch (error) {
    setup.error = error.message;
    return null;
  } finally {
    shown();
  }
}

export const question = (path) => ask(`/api/setup/${path}`);

async function refresh() {
  const before = orders;
  try {
    const state = await question("state");
    if (before === orders) take(state);
    setup.lost = false;
  } catch (error) {
    if (!setup.state) throw error;
    setup.lost = true;
  }
}

export async function begin() {
  await refresh();
  shown();
  setTimeout(begin, busy() || running() ? BUSY_MS : IDLE_MS);
}
