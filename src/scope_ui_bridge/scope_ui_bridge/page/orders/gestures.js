// Gestures at the selection: press, double, long, hold; turn, clicks and positions of a knob; draw a line.

import { desk } from "../connection/desk.js";
import { find, svg } from "../elements/dom.js";
import { numberOf, putNumber } from "../elements/number_fields.js";
import { seenOf } from "../picture/panel_seen.js";
import { collect, collecting } from "./sequence.js";

let dialOf = 0; // number of the selection whose angle the dial shows

/** Fields of a confirmation in addition to selection and picture. */
function wanted(button) {
  const gesture = button.dataset.act;
  const sign = Number(button.dataset.sign ?? 1);
  const value = (id) => numberOf(find(id));
  if (gesture === "hold") return { argument: value("hold-seconds") };
  if (gesture === "turn") return { argument: sign * value("turn-degrees") };
  if (gesture === "click") return { argument: sign * value("click-count") };
  if (gesture === "set") {
    const mark = find("set-mark").value;
    return mark ? { mark } : { argument: value("set-degrees") };
  }
  return {};
}

function hindrance(gesture, { argument }) {
  if (desk.gestureHindrance) return desk.gestureHindrance;
  if (!desk.selection) return { code: "selection_gone" };
  if (!desk.selection.gestures.includes(gesture)) return { code: "wrong_gesture" };
  return Number.isNaN(argument) ? { code: "no_number" } : null;
}

/** Carry out the button's gesture, or show why it is not possible now. */
export function act(button) {
  const gesture = button.dataset.act;
  const fields = wanted(button);
  const refusal = hindrance(gesture, fields);
  if (refusal) {
    desk.refuse(refusal);
    return;
  }
  if (collecting()) {
    collect(gesture, fields);
    return;
  }
  document.dispatchEvent(new Event("acting")); // the current picture is kept for comparison
  desk.ask("act", { gesture, selection: desk.selection.number, ...desk.seen, ...fields });
}

// --- the dial: current and wanted angle of a knob's marker; degrees counter-clockwise from up ---------------------------

function turned(event) {
  const area = find("dial").getBoundingClientRect();
  const [x, y] = [event.clientX - area.left - area.width / 2, event.clientY - area.top - area.height / 2];
  if (Math.hypot(x, y) < 6) return;
  putNumber(find("set-degrees"), Math.round((Math.atan2(-x, -y) * 180) / Math.PI));
  find("set-mark").value = "";
  renderDial();
}

function hand(name, degrees) {
  const line = find("dial").querySelector(`.${name}`);
  line.setAttribute("visibility", Number.isFinite(degrees) ? "visible" : "hidden");
  if (Number.isFinite(degrees)) line.setAttribute("transform", `rotate(${-degrees})`);
}

function renderDial() {
  const seen = seenOf(desk.selection?.control);
  const mark = find("set-mark").value;
  hand("seen", seen?.angle_deg ?? NaN);
  hand("wanted", mark ? seen?.marks[mark] ?? NaN : numberOf(find("set-degrees")));
}

function newKnob(seen) {
  const marks = Object.keys(seen?.marks ?? {});
  find("set-mark").replaceChildren(new Option("–", ""), ...marks.map((name) => new Option(name, name)));
  find("set-mark").closest("label").hidden = marks.length === 0;
  putNumber(find("set-degrees"), seen?.angle_deg ?? NaN); // where it stands is not known: nobody has said where to
  const ticks = Object.values(seen?.marks ?? {}).map((degrees) =>
    svg("path", { d: "M0 -46V-38", transform: `rotate(${-degrees})` }),
  );
  find("dial").querySelector(".marks").replaceChildren(...ticks);
}

export function wireGestures() {
  for (const button of document.querySelectorAll("[data-act]")) button.addEventListener("click", () => act(button));
  const dial = find("dial");
  dial.addEventListener("pointerdown", (event) => {
    dial.setPointerCapture(event.pointerId);
    turned(event);
  });
  dial.addEventListener("pointermove", (event) => dial.hasPointerCapture(event.pointerId) && turned(event));
  find("set-degrees").addEventListener("input", () => {
    find("set-mark").value = "";
    renderDial();
  });
  find("set-mark").addEventListener("change", renderDial);
}

export function renderGestures() {
  const { selection } = desk;
  const reason = desk.whyNot;
  for (const button of document.querySelectorAll("[data-act]")) {
    const able = selection ? selection.gestures.includes(button.dataset.act) : button.dataset.act === "press";
    (button.closest("[data-for]") ?? button).hidden = !able;
    button.disabled = !selection || !able || reason !== "";
  }
  if (selection && selection.kind === "knob") {
    if (dialOf !== selection.number) newKnob(seenOf(selection.control));
    renderDial();
  }
  dialOf = selection?.number ?? 0;
}
