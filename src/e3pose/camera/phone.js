// A phone as a camera: sends what its camera sees, one JPEG after the other, and tries for ever.
const MOST_FPS = 25, QUALITY = 0.8, RETRY_MS = 1000, TIME_MS = 2000, TIMES = 5;
const at = (id) => document.getElementById(id), say = (words) => (at("state").textContent = words);
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const video = at("video"), canvas = document.createElement("canvas");
let secret = localStorage.getItem("secret"), offsets = [], asked_ms = -Infinity;

// What the server answers; an error where it refuses, with its words, or is not there.
async function ask(path, options = {}) {
  const answer = await fetch(path, { ...options, headers: { ...options.headers, ...(secret && { Authorization: `Bearer ${secret}` }) } });
  const said = await answer.json();
  if (!answer.ok) throw Object.assign(new Error(said.detail), { status: answer.status });
  return said;
}

// Learn by how much the camera's clock is ahead of ours: of the last exchanges, the fastest tells best.
async function tellTime() {
  const sent_ms = performance.now(), { now_ms } = await ask("/time"), back_ms = performance.now();
  offsets = [...offsets, { trip_ms: back_ms - sent_ms, ahead_ms: now_ms - (sent_ms + back_ms) / 2 }].slice(-TIMES);
  asked_ms = back_ms;
}
const best = () => offsets.reduce((a, b) => (b.trip_ms < a.trip_ms ? b : a));

// Wait for a frame; return when it was taken, by our clock.
const frame = () => new Promise((done) => {
  if (!video.requestVideoFrameCallback) return setTimeout(() => done(performance.now()), 1000 / MOST_FPS);
  video.requestVideoFrameCallback((now, { captureTime }) => done(captureTime <= now && captureTime > now - 1000 ? captureTime : now));
});

async function send(track) {
  const nominal = Math.min(track.getSettings().frameRate || MOST_FPS, MOST_FPS);
  for (let next_ms = 0; track.readyState === "live"; ) {
    const taken_ms = await frame();
    if (taken_ms < next_ms) continue;
    next_ms = Math.max(next_ms + 1000 / MOST_FPS, taken_ms - 1000 / MOST_FPS);
    [canvas.width, canvas.height] = [video.videoWidth, video.videoHeight];
    canvas.getContext("2d").drawImage(video, 0, 0);
    const body = await new Promise((done) => canvas.toBlob(done, "image/jpeg", QUALITY));
    try {
      if (performance.now() - asked_ms > TIME_MS) await tellTime();
      const { fps } = await ask("/frame", { method: "POST", body, headers: { Taken: String(taken_ms + best().ahead_ms), Rate: String(nominal) } });
      say("Sending.");
      at("rate").textContent = `${canvas.width} × ${canvas.height}, ${fps.toFixed(1)} frames a second, clock known to ${Math.max(1, Math.round(best().trip_ms / 2))} ms`;
    } catch (error) {
      if (error.status === 401) return say(`${error.message}: have e3pose show a new code, and scan it.`);
      say(error.status ? error.message : "Waiting: nobody reads this camera at the moment. Keep this page open.");
      offsets = [];
      asked_ms = -Infinity;
      await pause(RETRY_MS);
    }
  }
  say("The camera was taken away, by another app or a call. Load this page again.");
}

async function start() {
  at("start").disabled = true;
  try {
    const wanted = { facingMode: "environment", width: { ideal: 1280 }, height: { ideal: 720 }, frameRate: { ideal: MOST_FPS } };
    video.srcObject = await navigator.mediaDevices.getUserMedia({ video: wanted, audio: false });
    await video.play();
  } catch (error) {
    at("start").disabled = false;
    return say(`The camera cannot be used: ${error.message}. Allow it for this page.`);
  }
  at("start").hidden = true;
  video.hidden = false;
  const awake = () => document.hidden || navigator.wakeLock?.request("screen").catch(() => {});
  document.addEventListener("visibilitychange", awake);
  awake();
  await send(video.srcObject.getVideoTracks()[0]);
}

async function begin() {
  const code = location.hash.slice(1);
  if (code) {
    try {
      secret = (await ask("/join", { method: "POST", body: code })).secret;
      localStorage.setItem("secret", secret);
    } catch (error) {
      if (!secret || !error.status) return say(error.status ? error.message : "e3pose does not answer: load this page again.");
    }
    history.replaceState(null, "", location.pathname);
  }
  if (!secret) return say("Scan the code that e3pose shows with this phone.");
  if (!navigator.mediaDevices) return say("This browser lets no page use the camera here: open the address with https.");
  say("Put the phone where it is to stay, then start its camera.");
  at("start").hidden = false;
  at("start").addEventListener("click", start);
  at("start").focus();
}

begin();
