// Translates texts of the graph's programs (reasons, states in sentences) into the page's language and time; unknown
// text remains unchanged.

import { localNumbers } from "./numbers.js";
import { PHRASES_DE } from "./phrases_de.js";

const PHRASES = { de: phrases(PHRASES_DE) };
const GLUE = ["; ", ": "];
const DEEPEST = 6;
const LONGEST = 1000;
const MANY = 2000;
const MOMENT = /\b\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:\d\d)/g;
const isOne = (value) => !value.includes("; ");
// Permitted values, best first: a value with two sentences may include the end of another phrase, so it is the second
// choice; an empty value ("24 samples{}" without a further remark) is the third.
const CHOICES = [{ least: 1, accepted: isOne }, { least: 1, accepted: () => true }, { least: 0, accepted: isOne }];
const known = new Map();

/** Return a text in the page's language. */
export function said(text) {
  const language = document.documentElement.lang;
  if (typeof text !== "string" || text.length > LONGEST) return text ?? "";
  const key = `${language} ${text}`;
  if (!known.has(key)) {
    if (known.size > MANY) known.clear();
    const words = language in PHRASES ? translated(text, PHRASES[language], 0) : text;
    known.set(key, words.replace(MOMENT, (moment) => ofTheClock(moment, language)));
  }
  return known.get(key);
}

function ofTheClock(moment, language) {
  const time = new Date(moment);
  if (Number.isNaN(time.getTime())) return moment;
  return time.toLocaleString(language, { dateStyle: "medium", timeStyle: "short", hourCycle: "h23" });
}

/** Templates without values by their text; the others as pieces between the values, longest text first. */
function phrases(table) {
  const whole = new Map(table.filter(([from]) => !from.includes("{}")));
  const parts = table.filter(([from]) => from.includes("{}")).map(([from, to]) => ({ pieces: from.split("{}"), to }));
  const letters = ({ pieces }) => pieces.join("").length;
  return { whole, parts: parts.sort((a, b) => letters(b) - letters(a)) };
}

function translated(text, { whole, parts }, depth) {
  const again = (part) => (depth < DEEPEST ? translated(part, { whole, parts }, depth + 1) : part);
  if (whole.has(text)) return whole.get(text);
  const [, quote, inner] = /^(['"])(.*)\1$/.exec(text) ?? [];
  if (inner) return `${quote}${again(inner)}${quote}`;
  for (const { least, accepted } of CHOICES) {
    for (const { pieces, to } of parts) {
      const values = valuesOf(text, pieces, least);
      if (values?.every(accepted)) return filled(to, values.map(again));
    }
  }
  // Checks of a sequence, each with the state that was seen instead.
  const [, check, instead, , more] = /^(\S+) \(([^()]+)\)(, (.+))?$/.exec(text) ?? [];
  if (check) return `${check} (${again(instead)})${more ? `, ${again(more)}` : ""}`;
  // Reasons are joined by "; " and ": "; each part may be a known phrase.
  for (const glue of GLUE) {
    const at = text.indexOf(glue);
    if (at <= 0) continue;
    return `${again(text.slice(0, at))}${glue}${again(text.slice(at + glue.length))}`;
  }
  return localNumbers(text);
}

/** Values between the pieces, each as short as possible with at least `least` letters; null if the order differs. */
function valuesOf(text, pieces, least) {
  const last = pieces.at(-1);
  if (!text.startsWith(pieces[0]) || !text.endsWith(last)) return null;
  const end = text.length - last.length;
  const values = [];
  let from = pieces[0].length;
  for (const piece of pieces.slice(1, -1)) {
    const at = text.indexOf(piece, from + least);
    if (at < 0 || at + piece.length > end) return null;
    values.push(text.slice(from, at));
    from = at + piece.length;
  }
  if (end < from + least) return null;
  return [...values, text.slice(from, end)];
}

function filled(template, values) {
  let next = 0;
  return template.replace(/\{(\d*)\}/g, (hole, number) => values[number === "" ? next++ : Number(number)] ?? hole);
}
