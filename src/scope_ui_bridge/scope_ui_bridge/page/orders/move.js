// Moving without touching: jog while a button is held, and move to a point; the stylus stays up.

import { desk } from "../connection/desk.js";
import { find, put } from "../elements/dom.js";
import { numberOf } from "../elements/number_fields.js";
import { t } from "../language/strings.js";

const HOLD_MS = 100;
const LATE_MS = 200;
const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

let held = null; // {dx, dy, step_mm, timer, dueMs}

function hold(dx, dy) {
  if (held?.dx === dx && held?.dy === dy) return;
  release();
  if (desk.hindrance) {
    desk.refuse(desk.hindrance);
    return;
  }
  held = { dx, dy, step_mm: Number(find("jog-step").value), timer: 0, dueMs: performance.now() };
  document.dispatchEvent(new Event("acting"));
  repeat();
}

/** Repeat the request while held; a refusal (limit, stop) ends it, and so does a picture over the live one. */
async function repeat() {
  const mine = held;
  if (!mine) return;
  if (desk.hindrance) {
    release();
    desk.refuse(desk.hindrance);
    return;
  }
  const { dx, dy, step_mm, dueMs } = mine;
  const now = performance.now();
  mine.timer = setTimeout(repeat, HOLD_MS);
  mine.dueMs = now + HOLD_MS;
  // The bridge has ended this jog and would start a new one. The arrow may have been released meanwhile.
  if (now - dueMs > LATE_MS) return;
  if (!(await desk.ask("jog", { dx, dy, step_mm, ...desk.seen })) && held === mine) release();
}

function release() {
  if (!held) return;
  clearTimeout(held.timer);
  const { step_mm } = held;
  held = null;
  // Its answer is not shown: the reason of a refused jog must remain readable.
  if (desk.mine) desk.link.ask("jog", { dx: 0, dy: 0, step_mm, ...desk.seen });
}

export function wireMove() {
  for (const button of document.querySelectorAll("[data-jog]")) {
    const [dx, dy] = button.dataset.jog.split(",").map(Number);
    button.addEventListener("pointerdown", (event) => {
      button.setPointerCapture(event.pointerId);
      hold(dx, dy);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) button.addEventListener(end, release);
    button.addEventListener("blur", () => held?.dx === dx && held?.dy === dy && release()); // not one held by key
    button.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch must not open a menu here
    button.addEventListener("keydown", (event) => {
      if (!["Enter", " "].includes(event.key)) return;
      event.preventDefault();
      if (!event.repeat) hold(dx, dy);
    });
    button.addEventListener("keyup", release);
  }
  document.addEventListener("keydown", (event) => {
    const way = event.shiftKey && WAYS[event.key];
    if (!way || find("help").open || event.target.closest("input, select, textarea")) return;
    event.preventDefault();
    if (!event.repeat) hold(...way);
  });
  document.addEventListener("keyup", (event) => {
    if (event.key === "Shift" || WAYS[event.key]) release();
  });
  window.addEventListener("blur", release);
  document.addEventListener("visibilitychange", release);
  find("go-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const [x_mm, y_mm] = ["go-x", "go-y"].map((id) => numberOf(find(id)));
    if (Number.isFinite(x_mm) && Number.isFinite(y_mm)) desk.ask("move", { x_mm, y_mm, ...desk.seen });
  });
}

export function renderMove() {
  const why = desk.whyNoMotion || (desk.state.driver.state === "idle" || held ? "" : t("move_needs_idle"));
  // A button pressed repeatedly keeps the focus during its last step.
  const again = desk.whyNoMotion ? null : document.activeElement.closest("[data-jog]");
  for (const button of document.querySelectorAll("[data-jog], #go")) button.disabled = why !== "" && button !== again;
  put(find("move-why"), why || t("move_hint"));
  for (const option of find("jog-step").options) option.disabled = Number(option.value) > desk.limits.jog_step_mm;
}
