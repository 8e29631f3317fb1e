// Texts of the graph's programs in the page's language: a message is a code with its values, and the sentence is looked
// up by the code. A text without a code, such as a name, is shown as it is.

import { localNumbers } from "./numbers.js";
import { has, language, t } from "./strings.js";

const MOMENT = /\b\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(?:\.\d+)?(?:Z|[+-]\d\d:\d\d)/g;

/** Return a message in the page's language; its own English if its program is of another version. */
export function said(message) {
  if (!message?.code) return inLocalTime(localNumbers(message ?? ""));
  const key = message.code.replaceAll(".", "-");
  if (!has(key)) return message.text ?? message.code;
  const values = Object.entries(message.values).map(([name, value]) => [name, typeof value === "number" ? value : said(value)]);
  return t(key, Object.fromEntries(values));
}

function inLocalTime(text) {
  return text.replace(MOMENT, (moment) => ofTheClock(moment, language()));
}

function ofTheClock(moment, language) {
  const time = new Date(moment);
  if (Number.isNaN(time.getTime())) return moment;
  return time.toLocaleString(language, { dateStyle: "medium", timeStyle: "short", hourCycle: "h23" });
}
