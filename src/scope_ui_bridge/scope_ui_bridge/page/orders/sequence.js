// Sequences: chosen, typed or collected from the gesture buttons; started with a second click; followed step by step.

import { timeText, wallNow } from "../connection/clock.js";
import { desk } from "../connection/desk.js";
import { answers, find, put, putSteady, say } from "../elements/dom.js";
import { said } from "../language/said.js";
import { t } from "../language/strings.js";

const ARMED_MS = 4000;
const ICON = { waiting: "○", work: "▶", done: "✓", failed: "✕", unknown: "?" };
let stored = [];
let run = null; // the bridge's report on the last sequence
let spokenOf = "";
let timer = 0;
let armedAt = 0;
let begun = ""; // the steps as written at the start of the last run

export function setSequences(list, last, robot) {
  if (place !== `steps ${robot}`) {
    place = `steps ${robot}`;
    bringBack();
  }
  stored = list;
  const before = find("sequence-choice").value;
  const options = stored.map(({ name, title }) => new Option(title ? `${name} – ${title}` : name, name));
  const typed = new Option(t("sequence_typed"), "");
  typed.dataset.text = "sequence_typed"; // changes with the language
  find("sequence-choice").replaceChildren(typed, ...options);
  if (stored.some(({ name }) => name === before)) find("sequence-choice").value = before;
  setSequence(last);
}

// --- what was written, kept in this browser --------------------------------------------------------------------------

let place = ""; // storage key with the robot's id: the same address may lead to another robot later
let note = null; // note about the kept steps: a key and its values

/** Storage of this tab, which survives a reload, and storage for the next tab. */
const stores = () => [sessionStorage, localStorage];

function keep() {
  const text = find("sequence-text").value;
  const kept = JSON.stringify({ text, who: desk.me.name, at: wallNow().getTime() });
  note = null;
  try {
    for (const store of stores()) text.trim() ? store.setItem(place, kept) : store.removeItem(place);
  } catch {
    note = ["steps_not_kept", {}]; // the browser's storage is disabled or full
  }
}

function kept() {
  try {
    const found = stores().map((store) => JSON.parse(store.getItem(place))).find((one) => one !== null);
    return typeof found?.text === "string" && Number.isFinite(found.at) ? found : null;
  } catch {
    return null;
  }
}

/** Restore the kept steps into their field, as if they had been typed now. */
function bringBack() {
  const field = find("sequence-text");
  const found = kept();
  if (!found || (field.value.trim() && field.value !== found.text)) return;
  field.value = found.text;
  note = ["steps_back", { who: String(found.who), time: timeText(found.at) }];
  say(t(...note));
}

// ---------------------------------------------------------------------------------------------------------------------

export function setSequence(next) {
  run = next;
  const key = `${run.status} ${run.number}`;
  if (run.status && key !== spokenOf && !["sent", "accepted"].includes(run.status)) say(verdict(), run.status !== "reached");
  spokenOf = key;
}

/** Steps that a start would send now. */
function wanted() {
  const chosen = stored.find(({ name }) => name === find("sequence-choice").value);
  if (chosen) return chosen.steps;
  const lines = find("sequence-text").value.split("\n").map((line) => line.trim());
  return lines.filter((line) => line && !line.startsWith("#"));
}

const running = () => run.status === "sent" || run.status === "accepted";

function verdict() {
  const values = { name: run.name || t("sequence"), number: run.number, all: run.steps.length, reason: said(run.reason) };
  return t(`sequence_${run.status}`, values);
}

// --- collecting ----------------------------------------------------------------------------------------------------

/** Whether gesture buttons add a step instead of moving anything; also while another tab is shown. */
export function collecting() {
  return find("sequence-collect").checked;
}

/** Add a gesture button's action as a step, with the chosen check. */
export function collect(gesture, { argument, mark }) {
  const { control, panel_mm: from, to_mm: to } = desk.selection;
  const place = ([x, y]) => `${(x / 1000).toFixed(4)},${(y / 1000).toFixed(4)}@panel_link`;
  const step = [gesture, control || place(from), to ? place(to) : mark ?? argument].filter((part) => part !== undefined);
  const check = find("sequence-check").value;
  const line = step.join(":") + (check && ` => ${check}`);
  const text = find("sequence-text");
  text.value = `${text.value.trimEnd()}\n${line}\n`.trimStart();
  find("sequence-choice").value = "";
  keep();
  say(t("sequence_added", { step: line }));
}

// --- starting ------------------------------------------------------------------------------------------------------

/** Whether a second click starts it: the first click was for the same steps. */
const armed = () => find("sequence-start").dataset.armed === wanted().join("\n");

function disarm() {
  clearTimeout(timer);
  delete find("sequence-start").dataset.armed;
}

async function start(event) {
  const button = find("sequence-start");
  if (armed() && !answers(event, armedAt)) return;
  if (!armed()) {
    clearTimeout(timer);
    button.dataset.armed = wanted().join("\n");
    armedAt = performance.now();
    timer = setTimeout(disarm, ARMED_MS);
    desk.changed();
    return;
  }
  disarm();
  const name = find("sequence-choice").value;
  document.dispatchEvent(new Event("acting"));
  const steps = wanted();
  if (await desk.ask("sequence", { ...(name ? { stored: name } : { steps }), ...desk.seen })) begun = steps.join();
}

export function wireSequence() {
  find("sequence-start").addEventListener("click", start);
  find("sequence-text").addEventListener("input", keep);
  find("sequence-clear").addEventListener("click", () => {
    find("sequence-text").value = "";
    keep();
  });
}

function status(index) {
  // Finished steps are known; without a link the current progress is unknown.
  if (running() && desk.link.silent && index + 1 >= run.number) return "unknown";
  if (!run.status || index + 1 > run.number) return run.status === "reached" ? "done" : "waiting";
  if (index + 1 < run.number || run.status === "reached") return "done";
  return running() ? "work" : "failed";
}

export function renderSequence() {
  if (!run) return;
  const mine = wanted();
  const shown = running() ? run.steps : mine.length ? mine : run.steps;
  // The last run's steps keep their marks while they are chosen.
  const marked = running() || !mine.length || [begun, run.steps.join()].includes(mine.join());
  const list = find("sequence-steps");
  const key = JSON.stringify([shown, marked && [run.status, run.number, run.reason], desk.link.silent, document.documentElement.lang]);
  if (list.dataset.key !== key) {
    list.dataset.key = key;
    list.replaceChildren(...shown.map((step, index) => item(step, marked ? status(index) : "waiting")));
  }
  const button = find("sequence-start");
  const why = desk.whyNot || (run.state ? "" : t("sequence_nobody")) || (mine.length ? "" : t("sequence_empty"));
  button.disabled = why !== "";
  if (!armed()) disarm();
  put(button, t(armed() ? "sequence_confirm" : "sequence_start", { count: mine.length }));
  put(find("sequence-kept"), note ? t(...note) : "");
  find("sequence-typed").hidden = find("sequence-choice").value !== "";
  const work = run.number ? "sequence_step" : "sequence_sent"; // the sequencer reports the number when it starts
  const known = running() ? t(work, { number: run.number, all: run.steps.length }) : run.status ? verdict() : "";
  const text = desk.link.silent ? "" : known; // the reason below is shown then
  if (text) put(find("sequence-said"), text);
  else putSteady(find("sequence-said"), why);
  find("sequence-said").dataset.status = text && run.status;
  find("collecting").hidden = !collecting();
}

function item(step, state) {
  const line = document.createElement("li");
  line.dataset.state = state;
  const [icon, text, spoken] = ["span", "code", "span"].map((tag) => document.createElement(tag));
  icon.className = "icon";
  icon.setAttribute("aria-hidden", "true");
  icon.textContent = ICON[state];
  text.textContent = step;
  spoken.className = "unseen";
  spoken.textContent = t(`step_${state}`);
  line.append(icon, text, spoken);
  if (state === "failed" && run.reason) {
    const why = document.createElement("span");
    why.className = "why";
    why.textContent = said(run.reason.code === "sequence.step_failed" ? run.reason.values.cause : run.reason);
    line.append(why);
  }
  return line;
}
