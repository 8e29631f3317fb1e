// State of the panel seen by recognition: lit lamps, angles of knobs, changed screens, hidden controls.

import { timeText } from "../connection/clock.js";
import { desk } from "../connection/desk.js";
import { find, put } from "../elements/dom.js";
import { has, t } from "../language/strings.js";

let controls = new Map();
let labels = new Map();

export function setPanel(list) {
  controls = new Map(list.map((control) => [control.name, control]));
}

/** Seen state of a control; unknown without a link. */
export function seenOf(name) {
  return desk.link.silent ? undefined : controls.get(name);
}

/** Seen state of a control in words; empty if there is none. */
export function seenText(name) {
  const seen = seenOf(name);
  if (!seen) return "";
  if (seen.hidden_by) return t(`hidden_${seen.hidden_by}`);
  if (seen.lamp) return t("lamp", { colour: has(`lamp_${seen.lamp}`) ? t(`lamp_${seen.lamp}`) : seen.lamp });
  if (seen.angle_deg !== null) return markText(seen) ?? t("at_degrees", { degrees: degrees(seen.angle_deg) });
  if (!seen.changed_ms) return "";
  return t("changed_at", { time: timeText(seen.changed_ms) });
}

/** Marked position of a knob, with its angle. */
function markText({ marks, angle_deg: angle }) {
  const near = Object.entries(marks).find(([, place]) => Math.abs(((angle - place + 540) % 360) - 180) <= 4);
  return near ? t("at_mark", { mark: near[0], degrees: degrees(angle) }) : undefined;
}

function degrees(value) {
  return `${value > 0 ? "+" : ""}${value}`;
}

/** List the panel's state; `shown` are the controls in the picture, which have labels. */
export function renderPanel(shown) {
  labels = new Map(shown.map((control) => [control.name, control.label]));
  const list = find("seen");
  const said = [...controls.keys()].map((name) => [name, seenText(name)]).filter(([, text]) => text !== "");
  const names = said.map(([name]) => name).join();
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...said.map(([name]) => row(name)));
  }
  for (const [name, text] of said) {
    const item = list.querySelector(`[data-seen="${name}"]`);
    const { lamp = "", hidden_by: hidden } = controls.get(name);
    item.dataset.lamp = hidden ? "" : lamp;
    item.dataset.hidden = hidden;
    put(item.querySelector("dt"), labels.get(name) ?? name);
    put(item.querySelector("dd span:last-child"), text);
  }
  find("seen-none").hidden = said.length > 0;
  put(find("seen-none"), t(desk.link.silent ? "link_down" : "seen_none"));
}

function row(name) {
  const item = document.createElement("div");
  item.dataset.seen = name;
  const [term, value, dot, text] = ["dt", "dd", "span", "span"].map((tag) => document.createElement(tag));
  dot.className = "lamp";
  dot.setAttribute("aria-hidden", "true");
  value.append(dot, text);
  item.append(term, value);
  return item;
}
