// Calibration step by step: completed steps, progress, positions of the tip, and accuracy of the result.

import { desk } from "../connection/desk.js";
import { find, put, svg } from "../elements/dom.js";
import { said } from "../language/said.js";
import { named } from "../elements/status.js";
import { t } from "../language/strings.js";

const FRAME_MM = [360, 220]; // minimum extent of the plot; a larger machine's positions extend it
const GOOD_MM = 0.25;
let facts = {};
let places = []; // [x, y] mm of the tip at each increase of the count
let lastDone = 0;

export function setFacts(next) {
  facts = next;
}

function boardsText() {
  const { progress: boards = "", ...covered } = facts.cameras ?? {};
  const reach = Object.fromEntries(Object.entries(covered).map(([name, value]) => [name, value.replace(" to ", "–")]));
  return boards && t("guide_boards", { boards: said(boards), ...reach });
}

function progress() {
  const { state, reason } = desk.state.calibration;
  const { done = 0, total = 0 } = (state === "calibrating" && reason.values) || {};
  return { done, all: total };
}

/** Add a position each time the count of measured positions has increased. */
export function sampleGuide() {
  if (!desk.state) return;
  const { done } = progress();
  if (done > 0 && (done < lastDone || lastDone === 0)) places = []; // another run; the end of a run keeps them
  if (done > lastDone && desk.state.position_mm) {
    places.push(desk.state.position_mm.slice(0, 2));
    drawPlaces();
  }
  lastDone = done;
}

function drawPlaces() {
  const [width, height] = FRAME_MM.map((least, axis) => Math.max(least, ...places.map((place) => place[axis])));
  find("coverage").setAttribute("viewBox", `0 0 ${width} ${height}`);
  find("coverage").replaceChildren(...places.map(([x, y]) => svg("circle", { cx: x, cy: height - y, r: 6 })));
}

/** Show whether a step is done; unknown without a link. */
function step(id, fulfilled) {
  const item = find(id);
  const done = desk.link.silent ? "unknown" : fulfilled ? "yes" : "no";
  item.dataset.done = done;
  put(item.querySelector(".icon"), { unknown: "?", yes: "✓", no: "○" }[done]);
  put(item.querySelector(".unseen"), t(done));
}

/** An unknown error, as of a calibration by hand, is shown as a dash. */
function millimetres(text) {
  const value = Number(text);
  return Number.isFinite(value) ? value.toFixed(3) : "–";
}

export function renderGuide() {
  const { driver, calibration, tip_seen } = desk.state;
  const { done, all } = progress();
  const { rms_mm: rms, held_out_max_mm: held, predicted_sigma_mm: predicted } = facts.calibration ?? {};
  const calibrated = calibration.state === "calibrated";
  const state = named(calibration);
  step("guide-machine", ["idle", "moving"].includes(driver.state));
  step("guide-tip", tip_seen);
  step("guide-run", calibrated);
  step("guide-result", state === "calibrated" && Number(held) <= GOOD_MM);
  const silent = desk.link.silent;
  const reason = calibration.reason && `${t("chip_calibration")}: ${t(`state_${state}`, { reason: said(calibration.reason) })}${
    state === "calibrating" ? "" : ` – ${said(calibration.reason)}`
  }`;
  const numbers = calibrated && rms
    ? t("guide_numbers", { rms: millimetres(rms), held: millimetres(held), predicted: millimetres(predicted) })
    : "";
  put(find("guide-run-text"), all && !silent ? t("guide_run", { done, all }) : t("guide_run_idle"));
  put(find("calibration-text"), silent ? t("link_down") : reason);
  put(find("guide-numbers"), silent ? "" : numbers);
  put(find("camera-coverage"), silent ? "" : boardsText());
  const xs = places.map(([x]) => x);
  const ys = places.map(([, y]) => y);
  const span = (values) => (values.length ? `${Math.min(...values).toFixed(0)} … ${Math.max(...values).toFixed(0)}` : "–");
  put(find("coverage-text"), `X ${span(xs)} mm · Y ${span(ys)} mm`);
}
