// Header and banner: states by text and icon in addition to colour.

import { putSteady, reachable } from "./dom.js";
import { said } from "../language/said.js";
import { t } from "../language/strings.js";

const LOOKS = {
  good: "✓", busy: "▶", waiting: "▲", bad: "■", none: "○", recording: "●",
};
const LOOK_OF = {
  idle: "good", ready: "good", calibrated: "good",
  moving: "busy", homing: "busy", looking: "busy", touching: "busy", calibrating: "busy", connecting: "busy",
  unhomed: "waiting", disabled: "waiting", waiting: "waiting", uncalibrated: "waiting", drifted: "waiting",
  stopped: "bad", alarm: "bad", disconnected: "bad", mismatch: "bad", failed: "bad",
};

export function chip(id, look, text, title = "") {
  const element = document.getElementById(id);
  const key = `${look} ${text} ${title}`;
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  element.dataset.look = look;
  element.title = title;
  const icon = document.createElement("span");
  icon.className = "icon";
  icon.setAttribute("aria-hidden", "true");
  icon.textContent = LOOKS[look];
  element.querySelector("dd").replaceChildren(icon, text);
}

/** The state's name for people: after a movement of the setup, a calibration is still used but less accurate than
stated. */
export function named({ state, reason }) {
  return state === "calibrated" && reason.code === "calibration.drifted" ? "drifted" : state;
}

/** Show a part's state; `more` is appended to its title. */
export function stateChip(id, { state: found, reason: told }, more = "") {
  const [state, reason] = [named({ state: found, reason: told }), said(told)];
  const text = state ? t(`state_${state}`, { reason }) : t("unknown");
  const full = reason && state !== "calibrating" ? `${text}: ${reason}` : text;
  chip(id, LOOK_OF[state] ?? "none", text, more ? `${full}; ${more}` : full);
}

/** Text repeated on the button next to the banner: a telephone has no room for it. */
function besideButton(text) {
  const element = document.createElement("span");
  element.className = "beside";
  element.textContent = text;
  return element;
}

/** Show the most urgent sentence that applies; the line is always present, so that nothing moves. */
export function banner(element, candidates) {
  const found = candidates.find((candidate) => candidate.when);
  const key = `${found.look} ${found.text} ${found.beside ?? ""}`;
  if (element.dataset.key === key) return;
  element.dataset.key = key;
  element.dataset.look = found.look;
  element.querySelector(".icon").textContent = LOOKS[found.look];
  const line = element.querySelector("p");
  line.setAttribute("role", found.look === "bad" ? "alert" : "status");
  if (found.look === "waiting") putSteady(line, found.text);
  else line.textContent = found.text;
  if (found.beside) line.append(" ", besideButton(found.beside));
  reachable(line);
}
