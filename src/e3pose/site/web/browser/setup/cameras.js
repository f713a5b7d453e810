// Cameras: find them, see them with their measured rate, name and turn them.
import { html, useEffect, useState } from "../vendor/preact.js";
import { busy, order, question, running, setup, turnTo } from "./state.js";

const PICTURE_MS = 700;

// The newest picture of a camera, asked for while it can be seen.
export function usePicture(id, off) {
  const [found, see] = useState(null);
  useEffect(() => {
    let timer = 0, gone = false;
    const next = async () => {
      if (!off && !document.hidden) {
        try {
          const now = await question(`cameras/${encodeURIComponent(id)}/picture`);
          if (!gone) see(now);
        } catch (error) {
          if (!gone) see((before) => ({ ...(before || { jpeg: null, fps: null }), why: error.message }));
        }
      }
      if (!gone) timer = setTimeout(next, PICTURE_MS);
    };
    next();
    return () => ((gone = true), clearTimeout(timer));
  }, [id, off]);
  return found;
}

// The code that a phone scans, until somebody puts it away.
function Code({ shown, put }) {
  return html`<section id="code" class="code" aria-label=${`Code for the phone ${shown.name}`}><img src=${shown.picture} alt="QR code of the address below" />
    <div><h3>Scan this with the phone for ${shown.name}</h3><p>The phone must be in the same network. This machine now listens there, beyond loopback, at port ${shown.port}; the code is valid for one phone and ${shown.minutes} minutes.</p>
    <p class="soft">The phone warns of the certificate, which is your own: its SHA-256 fingerprint is <code>${shown.fingerprint}</code></p>
    <p class="soft">Without a camera for codes: <a id="phone-url" href=${shown.url} target="_blank" rel="noopener">${shown.url.replace(/#.*/, "#…")}</a> · The same: <code>${shown.command}</code></p>
    <button type="button" id="code-away" onClick=${() => put(null)}>Hide the code</button></div></section>`;
}

function Camera({ camera, show }) {
  const { id, source, rotation, width, height, fps, announced } = camera, off = busy() || running(), isPhone = source.startsWith("phone:");
  const found = usePicture(id, off), [name, type] = useState(id), path = `cameras/${encodeURIComponent(id)}`;
  useEffect(() => type(id), [id]);
  const rename = () => name.trim() && name !== id && order(path, { name: name.trim() });
  const rate = found?.fps ?? (fps || null);
  const words = [width ? `${width} × ${height}` : "", rate ? `${rate.toFixed(1)} frames a second${found?.fps ? "" : " when added"}` : ""].filter(Boolean).join(", ");
  return html`<li class="camera"><div class="frame">${found?.jpeg ? html`<img src=${`data:image/jpeg;base64,${found.jpeg}`} alt=${`Picture of ${id}`} class=${off || found.why ? "old" : ""} />` : html`<span class="soft">${off ? "in use" : isPhone && found ? "waiting for the phone: its page must be open, and its camera started" : found?.why || "…"}</span>`}</div>
    <label class="row">Name <input value=${name} maxlength="64" disabled=${off} autocomplete="off" onInput=${(event) => type(event.target.value)} onBlur=${rename} onKeyDown=${(event) => event.key === "Enter" && event.target.blur()} /></label>
    <p class="soft source" title=${source}>${source}</p>
    <p class="rate">${words}</p>
    ${announced > fps && fps ? html`<p class="unsure">It announces ${announced.toFixed(1)} frames a second.</p>` : ""}
    ${found?.jpeg && found.why && html`<p class="bad">${found.why}</p>`}
    <p class="row"><button type="button" disabled=${off} onClick=${() => order(path, { rotation: (rotation + 90) % 360 })}>Turn<span class="hidden"> ${id}</span>${rotation ? ` (${rotation}°)` : ""}</button>
    ${isPhone && html`<button type="button" aria-label=${`New code for ${id}`} onClick=${async () => show(await order(`phones/${encodeURIComponent(id)}`))}>New code</button>`}
    <button type="button" disabled=${off} aria-label=${`Remove ${id}`} onClick=${() => order(path, { remove: true })}>Remove</button></p></li>`;
}

// A camera that answered: its streams, or who may ask for them.
function InNetwork({ one, add, off, again }) {
  const [user, typeUser] = useState(""), [password, typePassword] = useState("");
  const submit = async (event) => {
    event.preventDefault();
    if (await order("streams", { host: one.host, user, password })) again();
  };
  return html`<li><b>${one.name || "a camera"}</b> <span class="soft">at ${one.host}</span>
    ${one.streams.map((stream) => html`<span class="row"><button type="button" disabled=${off} onClick=${() => add([stream.source])}>Add</button> ${stream.name}</span>`)}
    ${!one.streams.length && html`<form class="row" onSubmit=${submit}><span class="soft">${one.why}</span><label>User <input value=${user} maxlength="64" autocomplete="off" onInput=${(event) => typeUser(event.target.value)} /></label>
      <label>Password <input type="password" value=${password} maxlength="128" autocomplete="off" onInput=${(event) => typePassword(event.target.value)} /></label><button type="submit">Ask for its streams</button></form>`}</li>`;
}

function Found({ found, add, off, again }) {
  const row = (source, title, detail) => html`<li key=${source}><button type="button" disabled=${off} onClick=${() => add([source])}>Add</button> <span>${title}</span> <span class="soft">${detail}</span></li>`;
  const { devices, films, network } = found, folders = new Map();
  for (const film of films) {
    const folder = film.includes("/") ? film.slice(0, film.lastIndexOf("/")) : "";
    folders.set(folder, [...(folders.get(folder) || []), film]);
  }
  return html`<h3>Cameras of this machine</h3>
    ${devices.length ? html`<ul class="found">${devices.map((one) => row(one.source, one.title, one.source))}</ul>` : html`<p class="soft">None found. Plug one in; your user must be in the group <code>video</code>.</p>`}
    <h3>Network cameras</h3>
    <p class="row"><button type="button" id="look" disabled=${busy()} onClick=${() => order("look")}>Look in the local network</button> <span class="soft">asks for ONVIF cameras, once</span></p>
    ${network.length > 0 && html`<ul class="found" id="network">${network.map((one) => html`<${InNetwork} key=${one.host} one=${one} add=${add} off=${off} again=${again} />`)}</ul>`}
    ${films.length > 0 && html`<h3>Films</h3><ul class="found" id="films">${[...folders].map(([folder, some]) => html`<li key=${folder}><details open=${folders.size < 3}><summary>${folder || "this folder"} <span class="soft">${some.length} films</span></summary>
      ${some.length > 1 && some.length <= 16 && html`<p><button type="button" disabled=${off} onClick=${() => add(some)}>Add all ${some.length}</button> <span class="soft">as cameras of one scene, filmed at the same time</span></p>`}
      <ul class="found">${some.map((film) => row(film, film.slice(film.lastIndexOf("/") + 1), ""))}</ul></details></li>`)}</ul>`}`;
}

export function Cameras() {
  const { cameras } = setup.state, off = busy() || running(), [typed, type] = useState(""), [found, find] = useState(null), [code, show] = useState(null), [phone, call] = useState("phone");
  const look = () => void (busy() || question("found").then(find, () => {}));
  useEffect(look, [busy(), cameras.length]);
  const add = (sources) => order("cameras", { sources });
  const submit = async (event) => {
    event.preventDefault();
    if (await order("cameras", { sources: [typed.trim()] })) type("");
  };
  const addPhone = async (event) => {
    event.preventDefault();
    const shown = await order("phones", { name: phone.trim() });
    if (shown) (show(shown), call(`phone${cameras.length + 2}`));
  };
  return html`<p>Add two cameras or more that see the same room. Four, at head height or above, one in each corner, see almost everything.</p>
    ${code && html`<${Code} shown=${code} put=${show} />`}
    ${cameras.length > 0 && html`<ul id="cameras">${cameras.map((camera) => html`<${Camera} key=${camera.source} camera=${camera} show=${show} />`)}</ul>`}
    ${cameras.length > 1 && html`<p><button type="button" id="next" class="main" disabled=${off} onClick=${() => turnTo("network")}>Next: the network</button></p>`}
    ${running() && html`<p class="notice">The site is running and has its cameras: stop it under Go live to change them.</p>`}
    <form class="typed" onSubmit=${submit}><label>Address or film <input id="typed" value=${typed} maxlength="500" placeholder="rtsp://10.0.0.7/stream" disabled=${off} onInput=${(event) => type(event.target.value)} /></label><button type="submit" disabled=${off || !typed.trim()}>Add</button></form>
    <form class="typed" onSubmit=${addPhone}><label>Phone, a name for it <input id="phone" value=${phone} maxlength="64" autocomplete="off" disabled=${off} onInput=${(event) => call(event.target.value)} /></label><button type="submit" id="add-phone" disabled=${off || !phone.trim()}>Add a phone</button></form>
    <p class="soft">Shows a code for it to scan. This machine then listens in your network for that phone while its pictures are needed.</p>
    ${!cameras.length && html`<p class="row"><button type="button" id="simulate" disabled=${off} onClick=${() => order("simulate")}>Try it without cameras</button> <span class="soft">makes four films of a simulated person who walks, and adds them</span></p>`}
    ${found && html`<${Found} found=${found} add=${add} off=${off} again=${look} />`}`;
}
