// Number fields, shown in the page's language and typed with a point or a comma. A browser's own number fields ignore a
// comma if its language has none: 1,5 mm would become 15 mm.

import { find } from "./dom.js";
import { localNumbers } from "../language/numbers.js";
import { t } from "../language/strings.js";

const TYPED = /^[+\-−]?(\d+([.,]\d*)?|[.,]\d+)$/;

/** Return a field's text as a number, NaN if it is none. */
export function numberOf(field) {
  const typed = field.value.trim();
  return TYPED.test(typed) ? Number(typed.replace(",", ".").replace("−", "-")) : NaN;
}

/** Write a number into a field; NaN or undefined clears it. */
export function putNumber(field, value) {
  field.value = Number.isFinite(value) ? localNumbers(value) : "";
  judge(field);
}

/** A field without a number, or with one out of bounds, blocks its form. */
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

/** Rewrite the shown numbers in another language. */
export function relabelNumbers() {
  for (const field of document.querySelectorAll("input[data-step]")) putNumber(field, numberOf(field));
  for (const option of find("jog-step").options) option.textContent = localNumbers(`${option.value} mm`);
}

/** Check the input of all number fields, also of later ones; arrow keys increase and decrease it. */
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
