// A camera joins by a code: for operators, where the key of the site's authority is on this machine.
import { html, useEffect, useState } from "./vendor/preact.js";
import { ask } from "./connection.js";

const LOOK_MS = 1000;
const NOTHING = { code: "", left_s: 0, said: "", waiting: [] };
const minutes = (s) => `${Math.floor(s / 60)}:${String(Math.floor(s % 60)).padStart(2, "0")}`;

export function Join() {
  const [seen, see] = useState(NOTHING), { code, left_s, said, waiting } = seen;
  const change = (method) => ask("/api/control/join", undefined, method).then(see, (error) => see({ ...NOTHING, waiting, said: error.message }));
  useEffect(() => void change("GET"), []);
  useEffect(() => {
    const timer = left_s > 0 ? setTimeout(() => change("GET"), LOOK_MS) : 0;
    return () => clearTimeout(timer);
  }, [seen]);
  return html`<section id="join" aria-labelledby="join-title"><h3 id="join-title">Add a camera</h3>
    <p class="soft">${waiting.length ? `Without a certificate: ${waiting.join(", ")}.` : "All cameras of the site have certificates."}</p>
    ${code && html`<p>Type this code at the camera, within <span id="join-left">${minutes(left_s)}</span>:</p>
      <p><output id="join-code" aria-label=${`Code ${[...code].join(" ")}`}>${code.slice(0, 3)} ${code.slice(3)}</output></p>
      <p class="soft">There: <code>e3pose camera --join --name ${waiting[0] || "NAME"} --source usb:0</code></p>`}
    ${!code && left_s > 0 && html`<p>A camera is joining …</p>`}
    <button type="button" id="join-button" disabled=${left_s > 0} onClick=${() => change("POST")}>Let a camera join</button>
    <p id="join-said" role="status">${said}</p></section>`;
}
