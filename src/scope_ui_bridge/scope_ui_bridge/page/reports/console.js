// Log messages of the machine's programs for engineers, read only.

import { timeText } from "../connection/clock.js";
import { find } from "../elements/dom.js";
import { t } from "../language/strings.js";

const MAX_LINES = 300;

export class Console {
  #element;

  constructor(element) {
    this.#element = element;
    this.reset([]);
  }

  /** Replace all lines by these. */
  reset(lines) {
    this.#element.textContent = t("console_empty");
    this.#element.dataset.text = "console_empty"; // changes with the language
    if (lines.length > 0) this.add(lines);
  }

  add(lines) {
    const element = this.#element;
    if ("text" in element.dataset) {
      delete element.dataset.text;
      element.replaceChildren();
    }
    const atEnd = element.scrollTop + element.clientHeight >= element.scrollHeight - 4;
    for (const { wall_ms, level, name, text } of lines) {
      const line = document.createElement("p");
      line.dataset.level = level;
      line.textContent = `${timeText(wall_ms)} ${level} ${name}: ${text}`;
      element.append(line);
    }
    while (element.children.length > MAX_LINES) element.firstElementChild.remove();
    if (atEnd) element.scrollTop = element.scrollHeight;
  }
}

/** Show the driver's counters by name. */
export function showCounts(counts = {}) {
  find("driver-facts").replaceChildren(...Object.entries(counts).map(([name, value]) => {
    const item = document.createElement("div");
    const [term, said] = ["dt", "dd"].map((tag) => document.createElement(tag));
    term.textContent = name.replaceAll("_", " ");
    said.textContent = value;
    item.append(term, said);
    return item;
  }));
}
