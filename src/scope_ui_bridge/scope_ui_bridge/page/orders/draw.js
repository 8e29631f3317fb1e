// A line on the instrument's touch screen: dragged in the picture, set by two clicks, or given in mm; then confirmed.

import { desk } from "../connection/desk.js";
import { find, press, say } from "../elements/dom.js";
import { numberOf, putNumber } from "../elements/number_fields.js";
import { t } from "../language/strings.js";

const DRAG_PX = 6; // a pointer that moves less has clicked
const SHARE = 0.3; // the proposed line goes from -0.3 to 0.3 of the screen's width
let on = false;
let from = null; // {pixel, at}: start of the line
let down = false;
let drawn = false; // the click that ends a stroke selects nothing
let screen = 0; // number of the selection for which a line was proposed

function show(active) {
  on = active;
  from = null;
  down = false;
  press(find("draw"), on);
  find("stage").classList.toggle("drawing", on);
  find("draw-hint").textContent = on ? t("draw_first") : "";
  find("stage").dispatchEvent(new CustomEvent("line", { detail: null }));
}

async function choose(line) {
  show(false);
  await desk.select(line);
}

function wirePicture(overlay) {
  const stage = find("stage");
  const preview = (to) => stage.dispatchEvent(new CustomEvent("line", { detail: from && to ? [from.pixel, to] : null }));
  const finish = (pixel) => {
    const [u, v] = from.pixel;
    choose({ u, v, to_u: pixel[0], to_v: pixel[1] });
  };
  const far = (event) => Math.hypot(event.clientX - from.at[0], event.clientY - from.at[1]) >= DRAG_PX;
  const handlers = {
    pointerdown: (event) => {
      if (event.button !== 0) return;
      down = true;
      if (from) return; // the second click
      from = { pixel: overlay.pixel(event), at: [event.clientX, event.clientY] };
      stage.setPointerCapture(event.pointerId);
    },
    pointermove: (event) => preview(overlay.pixel(event)),
    pointerup: (event) => {
      if (!down || !from) return;
      down = false;
      if (far(event)) finish(overlay.pixel(event));
      else find("draw-hint").textContent = t("draw_second");
    },
    pointercancel: () => show(true),
    click: () => {}, // selects nothing while a line is drawn
  };
  for (const [name, handle] of Object.entries(handlers)) {
    stage.addEventListener(
      name,
      (event) => {
        if (name === "pointerdown") drawn = on;
        if (!on && !(name === "click" && drawn)) return;
        if (name === "click" && event.detail === 0) return; // by key: it chooses, as always
        event.stopImmediatePropagation();
        handle(event);
      },
      true,
    );
  }
}

export function wireDraw(overlay) {
  wirePicture(overlay);
  find("stage").addEventListener("line", ({ detail }) => overlay.line(detail));
  find("draw").addEventListener("click", () => {
    show(!on);
    if (on) say(t("draw_first"));
  });
  find("line-form").addEventListener("submit", (event) => {
    event.preventDefault();
    const fields = ["x_mm", "y_mm", "to_x_mm", "to_y_mm"];
    const line = Object.fromEntries(fields.map((name) => [name, numberOf(find(`line-${name}`))]));
    if (Object.values(line).every(Number.isFinite)) choose(line);
  });
}

/** Offer lines if the selection permits them; propose one across the screen's middle. */
export function renderDraw(controls) {
  const { selection } = desk;
  const may = controls.some((control) => control.kind === "touch_area");
  // A refused line clears the selection; its numbers remain for correction.
  const fits = selection ? ["touch_area", "point", "line"].includes(selection.kind) : find("line-form").parentElement.open;
  // Without a link the card remains, disabled, so that nothing below it moves.
  find("draw-card").hidden = !may || !(desk.mine || desk.link.silent) || !fits;
  find("draw").disabled = desk.whyNoMotion !== "" || desk.video.camera !== "left";
  if (on && (find("draw-card").hidden || find("draw").disabled)) show(false);
  if (selection?.kind !== "touch_area" || selection.number === screen) return;
  screen = selection.number;
  const [x, y] = selection.panel_mm;
  const half = SHARE * selection.size_mm[0];
  const proposed = { x_mm: x - half, y_mm: y, to_x_mm: x + half, to_y_mm: y };
  for (const [name, value] of Object.entries(proposed)) putNumber(find(`line-${name}`), Number(value.toFixed(1)));
}
