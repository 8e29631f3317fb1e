// Functions on the document for several parts of the page.

import { wallNow } from "../connection/clock.js";

export const find = (id) => document.getElementById(id);

/** Change a text only if it differs: screen readers announce every change. */
export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

const STEADY_MS = 5000;
const written = new WeakMap(); // when putSteady last wrote an element's text
const words = (text) => text.replace(/[\d.,]+/g, "");

/** As put, but a running number, such as an age, is written only every 5 s: screen readers would never finish. */
export function putSteady(element, text) {
  const since = performance.now() - (written.get(element) ?? -Infinity);
  if (words(element.textContent) === words(text) && since < STEADY_MS) return;
  written.set(element, performance.now());
  put(element, text);
}

/** Make a text that is longer than its box scrollable by keyboard, and mark it until its end has been seen. */
export function reachable(element) {
  const below = element.scrollHeight - element.clientHeight;
  element.toggleAttribute("data-more", below - element.scrollTop > 2);
  if (below > 0) element.tabIndex = 0;
  else if (element !== document.activeElement) element.removeAttribute("tabindex");
}

export function press(button, on) {
  button.setAttribute("aria-pressed", String(on));
}

/** Whether a click confirms the question of `askedAt`: not the second of a double click, nor an earlier click. */
export function answers(event, askedAt) {
  return event.detail <= 1 && event.timeStamp > askedAt;
}

const TOGETHER_MS = 1000;

/** Announce a text to screen readers without cutting off a recent urgent one: a stop ends a press, and both results
count. */
export function say(text, urgent = false) {
  const place = find(urgent ? "say-now" : "say");
  const isNew = !urgent || performance.now() - (written.get(place) ?? -Infinity) > TOGETHER_MS;
  if (isNew) written.set(place, performance.now());
  place.textContent = isNew || place.textContent === text ? text : `${place.textContent} ${text}`;
}

/** Create an SVG element. */
export function svg(tag, attributes) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

/** A path as a bright line over a dark one: visible on any picture. */
export function doubled(d, name = "") {
  return ["under", "over"].map((layer) => svg("path", { d, class: `${layer} ${name}` }));
}

/** Save a file by the browser. */
export function save(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Local time as part of a file's name. */
export function fileTime(date = wallNow()) {
  const two = (value) => String(value).padStart(2, "0");
  const day = `${date.getFullYear()}-${two(date.getMonth() + 1)}-${two(date.getDate())}`;
  return `${day}_${two(date.getHours())}-${two(date.getMinutes())}-${two(date.getSeconds())}`;
}
