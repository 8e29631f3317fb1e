// The last command's result next to the buttons that gave it.

import { find, say } from "../elements/dom.js";
import { ICONS, spoken } from "./command_log.js";

export const UNDER_WAY = ["sent", "accepted"];
let last = null; // entry of the last command that was no stop
let boot = ""; // id of the bridge's run of that entry

export function showLast(entry) {
  last = entry;
  const element = find("last");
  element.hidden = false;
  element.dataset.status = entry.status;
  element.firstElementChild.textContent = ICONS[entry.status] ?? "";
  element.lastElementChild.textContent = spoken(entry);
}

/** Write it again, in another language. */
export function relabelLast() {
  if (last) showLast(last);
}

/** The last command may have ended while the link was lost; another run of the bridge has no entry of it. */
export function catchUp({ boot: run, log: entries }) {
  if (last && UNDER_WAY.includes(last.status)) {
    const known = run === boot && entries.find(({ entry }) => entry === last.entry);
    showLast(known || { ...last, status: "no_answer" });
    if (!UNDER_WAY.includes(last.status)) say(spoken(last), true);
  }
  boot = run;
}
