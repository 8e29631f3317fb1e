// Fields of numbers, written as the page's language does, and as people type them: with a point or with a comma.
// A browser's own number fields take a comma for nothing where its language has none: 1,5 mm would become 15 mm.

import { find } from "./dom.js";
import { localNumbers } from "./numbers.js";
import { t } from "./strings.js";

const TYPED = /^[+\-−]?(\d+([.,]\d*)?|[.,]\d+)$/;

/** Return what was typed into a field as a number, NaN where it is none. */
export function numberOf(field) {
  const typed = field.value.trim();
  return TYPED.test(typed) ? Number(typed.replace(",", ".").replace("−", "-")) : NaN;
}

/** Write a number into a field; NaN or nothing empties it. */
export function putNumber(field, value) {
  field.value = Number.isFinite(value) ? localNumbers(value) : "";
  judge(field);
}

/** The form that a field is in is not sent while it holds no number, or one beyond its bounds. */
function judge(field) {
  const [min, max] = [Number(field.dataset.min), Number(field.dataset.max)];
  const value = numberOf(field);
  const good = field.value === "" || (value >= min && value <= max);
  field.setCustomValidity(good ? "" : t("number_wanted", { min, max }));
}

function step(field, up) {
  const [by, min, max] = ["step", "min", "max"].map((name) => Number(field.dataset[name]));
  const next = (Number.isNaN(numberOf(field)) ? 0 : numberOf(field)) + (up ? by : -by);
  putNumber(field, Math.min(Math.max(Number(next.toFixed(3)), min), max));
  field.dispatchEvent(new Event("input", { bubbles: true }));
}

/** Write the numbers that stand there anew, in another language. */
export function relabelNumbers() {
  for (const field of document.querySelectorAll("input[data-step]")) putNumber(field, numberOf(field));
  for (const option of find("jog-step").options) option.textContent = localNumbers(`${option.value} mm`);
}

/** Look at what is typed into the fields of numbers, also those that are made later; arrows make it more or less. */
export function wireNumbers() {
  relabelNumbers();
  const isOne = (element) => element.matches("input[data-step]");
  document.addEventListener("input", ({ target }) => isOne(target) && judge(target));
  document.addEventListener("keydown", (event) => {
    if (!isOne(event.target) || event.shiftKey || !["ArrowUp", "ArrowDown"].includes(event.key)) return;
    event.preventDefault();
    step(event.target, event.key === "ArrowUp");
  });
}
