// What the programs of the graph say (reasons, states in sentences), in the page's language and its time; unknown text
// stays as it is.

import { localNumbers } from "./numbers.js";
import { PHRASES_DE } from "./phrases_de.js";

const PHRASES = { de: phrases(PHRASES_DE) };
const GLUE = ["; ", ": "];
const DEEPEST = 6;
const LONGEST = 1000;
const MANY = 2000;
const MOMENT = /\b\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:\d\d)/g;
const isOne = (value) => !value.includes("; ");
// What values may be: a value that holds two sentences may have swallowed the end of another phrase, so it is the second
// choice; that one says nothing ("24 samples{}" with nothing more about them) is the third.
const CHOICES = [{ least: 1, accepted: isOne }, { least: 1, accepted: () => true }, { least: 0, accepted: isOne }];
const known = new Map();

/** Return it in the page's language. */
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

/** Templates without values by their text; the others as pieces between the values, those that say most first. */
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
  // Checks of a sequence, each with what was seen instead.
  const [, check, instead, , more] = /^(\S+) \(([^()]+)\)(, (.+))?$/.exec(text) ?? [];
  if (check) return `${check} (${again(instead)})${more ? `, ${again(more)}` : ""}`;
  // Reasons are put together by "; " and ": "; each part may be known.
  for (const glue of GLUE) {
    const at = text.indexOf(glue);
    if (at <= 0) continue;
    return `${again(text.slice(0, at))}${glue}${again(text.slice(at + glue.length))}`;
  }
  return localNumbers(text);
}

/** What stands between the pieces, each value as short as it can be but of `least` letters; null when they are not
 * there in this order. */
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
