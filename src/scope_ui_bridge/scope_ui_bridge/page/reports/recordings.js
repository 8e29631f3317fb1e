// Running recordings and their duration, whichever program started them: in the head for everyone, as text next to the buttons.

import { desk } from "../connection/desk.js";
import { find, put, say } from "../elements/dom.js";
import { chip } from "../elements/status.js";
import { t } from "../language/strings.js";

let running = []; // {who, program, for_s, at_least}

export function setRecordings(list) {
  if (running.length < list.length) say(t("recording_on"));
  if (running.length > list.length) say(t(list.length ? "recording_one_less" : "recording_off"));
  running = list;
}

/** Whether the bridge itself records: this page cannot end another program's recording. */
export const records = () => running.some(({ who }) => who !== "");

function duration({ for_s: seconds }) {
  const two = (value) => String(value).padStart(2, "0");
  const [hours, minutes] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60];
  return `${hours ? `${hours}:${two(minutes)}` : minutes}:${two(seconds % 60)}`;
}

function line(one) {
  const key = one.who ? "recording_by" : one.at_least ? "recording_at_least" : "recording_program";
  return t(key, { time: duration(one), who: one.who || one.program });
}

export function renderRecordings() {
  find("chip-recording").hidden = find("recordings").hidden = running.length === 0;
  if (running.length === 0) return;
  const longest = running.reduce((long, one) => (one.for_s > long.for_s ? one : long));
  const lines = desk.link.silent ? [t("unknown")] : running.map(line);
  const time = `${longest.at_least ? "≥ " : ""}${duration(longest)}`;
  const known = !desk.link.silent;
  chip("chip-recording", known ? "recording" : "none", known ? time : t("unknown"), lines.join("\n"));
  put(find("recordings"), lines.join("\n"));
}
