// The strips over time and the energy bars, drawn by Plotly; a cursor follows the player.
"use strict";

const FIGURES = JSON.parse(document.getElementById("figures").textContent);
const QUIET = { displayModeBar: false, responsive: true };

function drawCharts() {
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
