// The strips over time and the energy bars, drawn by Plotly; a cursor follows the player.
"use strict";

const FIGURES = JSON.parse(document.getElementById("figures").textContent);
const QUIET = { displayModeBar: false, responsive: true };

const NARROW_PX = 620;

// On a phone: smaller margins, and titles that begin at the edge of the page.
function fitNarrow({ layout }) {
  Object.assign(layout.margin, { l: 58, r: Math.min(layout.margin.r, 44) });
  for (const note of layout.annotations || []) {
    if (note.xanchor === "left") note.xshift = -54;
    note.font.size = 11;
  }
  for (const axis of Object.values(layout)) if (axis && axis.title && axis.title.text) axis.title.font = { size: 11 };
}

function drawCharts() {
  if (window.innerWidth < NARROW_PX) Object.values(FIGURES).forEach(fitNarrow);
  for (const [id, figure] of Object.entries(FIGURES)) {
    const chart = byId(id);
    if (chart) Plotly.newPlot(chart, figure.data, figure.layout, QUIET);
  }
  const strips = byId("strips");
  if (!strips || last < 0) return;
  const { l, r } = FIGURES.strips.layout.margin, cursor = byId("cursor");
  const share = (index) => (index + 0.5) / (last + 1);
  const inner = () => strips.clientWidth - l - r;
  const follow = (index) => (cursor.style.transform = `translateX(${l + inner() * share(index)}px)`);
  const seekTo = (event) => {
    const x = (event.clientX - strips.getBoundingClientRect().left - l) / inner();
    if (x >= 0 && x <= 1) seek(Math.floor(x * (last + 1)));
  };
  strips.addEventListener("pointerdown", seekTo);
  strips.addEventListener("pointermove", (event) => event.buttons && seekTo(event));
  window.addEventListener("resize", () => follow(frame));
  listeners.push(follow);
  follow(frame);
}

drawCharts();
