// Plots of the last minute: position, age of the picture, and link; and measured errors of the last touches.

import { desk } from "../connection/desk.js";
import { find, put, svg } from "../elements/dom.js";
import { localNumbers } from "../language/numbers.js";
import { t } from "../language/strings.js";

const SPAN_MS = 60_000;
const NOW_MS = 1000; // older values are drawn, but not shown as current
const [WIDTH, HEIGHT] = [340, 84];
const series = { x: [], y: [], stylus: [], picture: [], link: [] };
const errors = []; // mm

export function sample(now) {
  const { state, link, video } = desk;
  const [x, y, stylus] = (!link.silent && state?.position_mm) || [];
  const values = { x, y, stylus, picture: video.ageMs, link: link.silent ? undefined : link.rttMs };
  for (const [name, points] of Object.entries(series)) {
    if (Number.isFinite(values[name])) points.push([now, values[name]]);
    while (points.length && points[0][0] < now - SPAN_MS) points.shift();
  }
}

export function addError(entry) {
  if (entry.error_mm !== null) errors.push(entry.error_mm);
  if (errors.length > 50) errors.shift();
}

function draw(id, lines, unit, digits) {
  const figure = find(id);
  if (!figure.offsetParent) return;
  const all = lines.flatMap(({ points }) => points.map((point) => point[1]));
  const high = Math.max(...all, 0);
  const low = Math.min(...all, 0);
  const drawing = figure.querySelector("svg");
  const place = ([px, value]) => `${px.toFixed(1)} ${(HEIGHT - 4 - ((value - low) / (high - low || 1)) * (HEIGHT - 8)).toFixed(1)}`;
  const paths = lines.map(({ points }) => (points.length ? `M${points.map(place).join("L")}` : ""));
  if ([...drawing.children].map((line) => line.getAttribute("d")).join() !== paths.join()) {
    drawing.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
    drawing.replaceChildren(...lines.map(({ name }, index) => svg("path", { class: `line-${name}`, d: paths[index] })));
  }
  const told = ({ label, last }) => `${label} ${localNumbers(last?.toFixed(digits) ?? "–")}`;
  put(figure.querySelector(".values"), `${lines.map(told).join(" · ")} ${unit}`);
  put(figure.querySelector(".range"), all.length ? localNumbers(`${low.toFixed(digits)} … ${high.toFixed(digits)} ${unit}`) : t("plot_empty"));
}

export function renderPlots(now) {
  const line = (name, label) => ({
    name,
    label,
    last: series[name].findLast(([at]) => at > now - NOW_MS)?.[1],
    points: series[name].map(([at, value]) => [WIDTH * (1 - (now - at) / SPAN_MS), value]),
  });
  draw("plot-position", [line("x", "X"), line("y", "Y"), line("stylus", t("axis_stylus"))], "mm", 1);
  draw("plot-latency", [line("picture", t("chip_video")), line("link", t("chip_link"))], "ms", 0);
  const step = WIDTH / Math.max(errors.length - 1, 1);
  const points = errors.map((value, index) => [index * step, value]);
  draw("plot-error", [{ name: "error", label: t("log_error"), last: errors.at(-1), points }], "mm", 2);
}
