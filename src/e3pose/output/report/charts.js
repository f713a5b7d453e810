// The strips over time and the energy bars, drawn by Plotly; a cursor follows the player.
"use strict";

// Of a dark page: text and marks light, and what is little as dark as the page.
const DARK_CHARTS = {
  "#1f2937": "#e2e8f0", "#e6e9ee": "#2d3542", "#b91c1c": "#f87171", "#d97706": "#f5a623", "#374151": "#c3cbd7", "#f4f1ee": "#1d1a18",
  "#7c2d12": "#ffb27d", "#f0f5f1": "#161c19", "#0b4f31": "#8ce8bb", "#f0f2f8": "#181b26", "#1e2f7a": "#a9b9ff", "#c3cad4": "#4a5466", '"#fff"': '"#14181f"',
};
let FIGURES = {};

function readFigures() {
  const text = byId("figures").textContent;
  FIGURES = JSON.parse(darkened.matches ? text.replace(/#[0-9a-f]{6}|"#fff"/g, (ink) => DARK_CHARTS[ink] || ink) : text);
}
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
  readFigures();
  if (window.innerWidth < NARROW_PX) Object.values(FIGURES).forEach(fitNarrow);
  for (const [id, figure] of Object.entries(FIGURES)) {
    const chart = byId(id);
    if (chart) Plotly.react(chart, figure.data, figure.layout, QUIET);
  }
}

// The cursor on the strips follows the player, and leads it.
function linkCharts() {
  const strips = byId("strips");
  if (!strips || !FIGURES.strips || last < 0) return;
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
linkCharts();
darkened.addEventListener("change", drawCharts);
