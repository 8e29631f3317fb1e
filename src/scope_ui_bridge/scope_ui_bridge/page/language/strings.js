// The page's sentences in the chosen language, from the Fluent files of this folder: one file for each language.

import { FluentBundle, FluentNumber, FluentResource } from "../vendor/fluent/index.js";
import { localNumbers } from "./numbers.js";

const KEPT = "language";
const GRAPH = "/messages/en.ftl"; // English of what the graph's programs report; other languages have it in their file
const UNGROUPED = { useGrouping: false, maximumFractionDigits: 20 };
const FUNCTIONS = {
  FIXED: ([value], { digits, sign }) => written(value, { ...ofDigits(digits), signDisplay: sign ? "always" : "auto" }),
  SHORT: ([value]) => written(value, { maximumSignificantDigits: 6 }),
  WORD: ([value]) => bundle.getMessage(`word-${value.valueOf()}`)?.value ?? value,
};

/** Name of each language -> its sentences. */
const bundles = new Map(await Promise.all((await fetched("/languages", "json")).map(async (name) => [name, await bundleOf(name)])));
let bundle = bundles.get("en");

async function fetched(address, as) {
  const answer = await fetch(address);
  if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
  return answer[as]();
}

async function bundleOf(name) {
  const files = [`/page/language/${name}.ftl`, ...(name === "en" ? [GRAPH] : [])];
  const made = new FluentBundle(name, { functions: FUNCTIONS, useIsolating: false });
  for (const text of await Promise.all(files.map((file) => fetched(file, "text")))) made.addResource(new FluentResource(text));
  return made;
}

const ofDigits = (digits) => ({ minimumFractionDigits: digits.valueOf(), maximumFractionDigits: digits.valueOf() });

/** A number as a function of a sentence writes it; a value that is no number, such as "nan", stays. */
function written(value, options) {
  return value instanceof FluentNumber ? new FluentNumber(value.valueOf(), { useGrouping: false, ...options }) : value;
}

/** Return the sentence of a key with its values; an unknown key is returned unchanged. */
export function t(key, values = {}) {
  const sentence = bundle.getMessage(key)?.value;
  if (!sentence) return String(key);
  const shown = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, ofSentence(value)]));
  return bundle.formatPattern(sentence, shown, []).replace(/\s+(?=[:.](\s|$))/g, "").trim();
}

function ofSentence(value) {
  return typeof value === "number" ? new FluentNumber(value, UNGROUPED) : isolated(localNumbers(value ?? ""));
}

const FROM_RIGHT = /[\u0590-\u08ff\ufb1d-\ufdff\ufe70-\ufefc\u{10800}-\u{10fff}\u{1e800}-\u{1efff}]/u;

/** Isolate a name, so that right-to-left text does not reverse the numbers and signs next to it. */
const isolated = (value) => (FROM_RIGHT.test(value) ? `\u2068${value}\u2069` : value);

export function has(key) {
  return bundle.hasMessage(key);
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

/** Name of the language after the current one, in its own words. */
export function nextLanguage() {
  const names = [...bundles.keys()];
  const name = names[(names.indexOf(language()) + 1) % names.length];
  return { name, title: bundles.get(name).getMessage("language_name").value };
}

/** Use the language chosen before, or the browser's. */
export function startLanguage() {
  setLanguage(localStorage.getItem(KEPT) ?? navigator.language.slice(0, 2));
}

function setLanguage(name) {
  const known = bundles.has(name) ? name : "en";
  bundle = bundles.get(known);
  document.documentElement.lang = known;
  fillTexts();
}

export function keepLanguage(name) {
  setLanguage(name);
  localStorage.setItem(KEPT, name);
}
