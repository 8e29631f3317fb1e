// The page's sentences in the chosen language; strings_en.js and strings_de.js have the same keys.

import { localNumbers } from "./numbers.js";
import { DE } from "./strings_de.js";
import { EN } from "./strings_en.js";

const LANGUAGES = { en: EN, de: DE };
const KEPT = "language";
let table = EN;

/** Return the sentence of a key with its values; an unknown key is returned unchanged (text from the graph). */
export function t(key, values = {}) {
  const sentence = table[key] ?? String(key);
  const filled = sentence.replace(/\{(\w+)\}/g, (whole, name) => isolated(localNumbers(values[name] ?? "")));
  return filled.replace(/\s+(?=[:.](\s|$))/g, "").trim();
}

const FROM_RIGHT = /[\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefc\u{10800}-\u{10fff}\u{1e800}-\u{1efff}]/u;

/** Isolate a name, so that right-to-left text does not reverse the numbers and signs next to it. */
const isolated = (value) => (FROM_RIGHT.test(value) ? `\u2068${value}\u2069` : value);

export function has(key) {
  return key in EN;
}

/** Fill in the texts named in the HTML. */
function fillTexts() {
  for (const element of document.querySelectorAll("[data-text]")) element.textContent = t(element.dataset.text);
  for (const element of document.querySelectorAll("[data-label]")) element.setAttribute("aria-label", t(element.dataset.label));
  for (const element of document.querySelectorAll("[data-title]")) element.title = t(element.dataset.title);
  for (const element of document.querySelectorAll("[data-placeholder]")) element.placeholder = t(element.dataset.placeholder);
}

export function language() {
  return document.documentElement.lang;
}

/** Use the language chosen before, or the browser's. */
export function startLanguage() {
  setLanguage(localStorage.getItem(KEPT) ?? navigator.language.slice(0, 2));
}

function setLanguage(name) {
  const known = name in LANGUAGES ? name : "en";
  table = LANGUAGES[known];
  document.documentElement.lang = known;
  fillTexts();
}

export function keepLanguage(name) {
  setLanguage(name);
  localStorage.setItem(KEPT, name);
}
