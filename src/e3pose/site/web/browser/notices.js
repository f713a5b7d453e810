// Notices that come and go: of the connection, the edge, the past, and those of the server.
import { html } from "./vendor/preact.js";
import { known } from "./known.js";
import { clock } from "./words.js";

const LOST_MS = 1500;

// What a reader has to know of the connection and the edge before all else; empty if all is well.
function first() {
  const { connected, edge, lostAt, notice, mode, status } = known;
  if (mode === "past") return notice;
  if (!connected && Date.now() - lostAt > LOST_MS) {
    return `No connection to e3pose view since ${clock(lostAt / 1000)}: it was stopped, or cannot be reached. The page connects again by itself; what it shows is old.`;
  }
  if (!status) return connected && !edge.there ? "Waiting for the edge. It is not running, or still starting." : "";
  if (connected && !edge.there) {
    return `Edge gone since ${clock(edge.heard_ns / 1e9)}: it was stopped, or cannot be reached. What is shown is its last state; the page goes on by itself when the edge is back.`;
  }
  if (status.compiling_s != null) {
    return status.compiling_s
      ? `The edge is compiling: ${Math.round(status.compiling_s)} s left, at the first start only. Until then there are few poses a second, and all cameras are active.`
      : "The edge is getting ready. A first start compiles for a minute or so, with few poses a second.";
  }
  if (known.smoothed && status.smoothed_ms === null) {
    return `The edge publishes no smoothed poses at present: ${status.overload ? "it is overloaded" : "it was started without a delay"}. Choose “now” to see poses.`;
  }
  return "";
}

export function Notices() {
  const text = first(), more = known.mode === "live" && known.edge.there && known.connected ? known.status?.notices || [] : [];
  return html`<div id="notices" role="status"><p id="notice" class="notice" hidden=${!text}>${text}</p>
    ${more.map(({ kind, text: words }) => html`<p key=${kind + words} class=${`notice ${kind}`}>${words}</p>`)}</div>`;
}
