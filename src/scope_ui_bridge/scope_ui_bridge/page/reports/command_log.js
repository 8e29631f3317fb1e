// The command log: newest first, each command one row that is updated until its result is known.

import { timeText, wallNow } from "../connection/clock.js";
import { fileTime, put, save } from "../elements/dom.js";
import { localNumbers } from "../language/numbers.js";
import { said } from "../language/said.js";
import { has, t } from "../language/strings.js";

export const ICONS = {
  sent: "…", accepted: "▶", reached: "✓", done: "✓", aborted: "✕", rejected: "✕", failed: "✕", no_answer: "?",
};
const MAX_ROWS = 200;

export class CommandLog {
  #body;
  #rows = new Map();
  #entries = new Map();
  #search = "";
  #day = "";
  #tell = () => {};

  constructor(body) {
    this.#body = body;
    this.reset([]);
  }

  reset(entries) {
    this.#rows.clear();
    this.#entries.clear();
    this.#body.replaceChildren();
    for (const entry of entries) this.show(entry);
    if (!entries.length) {
      const row = this.#body.insertRow();
      row.className = "nothing";
      row.insertCell().textContent = t("log_empty");
      row.cells[0].colSpan = 5;
    }
    this.#tell();
  }

  /** Rewrite all rows in another language. */
  relabel() {
    this.reset([...this.#entries.values()]);
  }

  /** Call often: at midnight, today's times become yesterday's and need their date. */
  watch() {
    const day = wallNow().toDateString();
    if (day === this.#day) return;
    this.#day = day;
    this.relabel();
  }

  wireSearch(field, found, button) {
    this.#tell = () => {
      const shown = [...this.#rows.values()].filter((row) => !row.hidden).length;
      put(found, this.#search ? t("log_found", { count: shown, all: this.#rows.size }) : "");
    };
    field.addEventListener("input", () => {
      this.#search = field.value.trim().toLowerCase();
      for (const row of this.#rows.values()) this.#filter(row);
      this.#tell();
    });
    button.addEventListener("click", () => save(`commands_${fileTime()}.csv`, new Blob([this.#csv()], { type: "text/csv" })));
  }

  #filter(row) {
    row.hidden = this.#search !== "" && !row.textContent.toLowerCase().includes(this.#search);
  }

  /** All entries (RFC 4180), oldest first; a text that a spreadsheet would evaluate gets a leading apostrophe. */
  #csv() {
    const about = ["wall_ms", "who", "action", "target", "status", "reason"];
    const fields = [...about, "error_mm", "bound_mm", "duration_s", "effect", "touch"];
    const cell = (value) => `"${String(value ?? "").replace(/^(?=[=+@\t\r]|-\D)/, "'").replaceAll('"', '""')}"`;
    const rows = [...this.#entries.values()].map((entry) =>
      [new Date(entry.wall_ms).toISOString(), ...fields.slice(1).map((name) => entry[name]?.text ?? entry[name])].map(cell).join(","),
    );
    return `${["time", ...fields.slice(1)].join(",")}\r\n${rows.join("\r\n")}\r\n`;
  }

  show(entry) {
    this.#body.querySelector(".nothing")?.remove();
    let row = this.#rows.get(entry.entry);
    if (!row) {
      row = this.#body.insertRow(0);
      for (let i = 0; i < 5; i += 1) row.insertCell();
      this.#rows.set(entry.entry, row);
    }
    this.#entries.set(entry.entry, entry);
    if (this.#rows.size > MAX_ROWS) this.#forget();
    row.dataset.status = entry.status;
    row.dataset.action = entry.action.code ?? entry.action.split(" ")[0];
    const [time, what, result, error, who] = row.cells;
    time.textContent = timeText(entry.wall_ms);
    what.textContent = `${actionText(entry)} ${targetText(entry)}`.trim();
    const icon = document.createElement("span");
    icon.className = "icon";
    icon.setAttribute("aria-hidden", "true");
    icon.textContent = ICONS[entry.status] ?? "";
    const text = document.createElement("strong");
    text.textContent = statusText(entry);
    result.replaceChildren(icon, text, ` ${toldOf(entry)}`);
    error.className = "number";
    error.textContent = entry.error_mm === null ? "" : errorText(entry);
    who.className = "who";
    who.textContent = entry.who;
    this.#filter(row);
    this.#tell();
  }

  #forget() {
    const [oldest, row] = this.#rows.entries().next().value;
    row.remove();
    this.#rows.delete(oldest);
    this.#entries.delete(oldest);
  }
}

/** The measured error, and the distance within which the tip was with 95 % probability. */
function errorText({ error_mm: error, bound_mm: bound }) {
  const value = error.toFixed(2);
  return typeof bound === "number" ? t("mm_bound", { value, bound: bound.toFixed(2) }) : t("mm", { value });
}

export function actionText(entry) {
  if (entry.action.code) return said(entry.action); // a goal of another client
  const [name, argument] = entry.action.split(" ");
  const value = Number(argument);
  const details =
    {
      hold: ` ${value} s`,
      sequence: ` (${value})`,
      turn: ` ${value > 0 ? "↺" : "↻"} ${localNumbers(Math.abs(value))}°`,
      click: ` ${value > 0 ? "↻" : "↺"} ${Math.abs(value)}`,
      set: ` ${Number.isFinite(value) ? localNumbers(`${value}°`) : argument}`,
    }[name] ?? "";
  // A goal of another client is shown as published, such as "move to (0.1, 0.2, 0) m in base_link".
  if (!has(`action_${name}`) || (argument && !details)) return said(entry.action);
  return t(`action_${name}`) + details;
}

export function targetText(entry) {
  return entry.action === "stop" ? t(entry.target) : localNumbers(entry.target); // a stop's is its cause
}

/** The status; an unanswered command that takes long has its current activity instead. */
function statusText({ status, action }) {
  const own = `under_way_${action}`;
  return t(status === "sent" && has(own) ? own : `status_${status}`);
}

/** The effect that was seen, and the reason of the result. */
function toldOf({ touch, effect, reason }) {
  return [touch ? t(`touch_${touch}`) : "", effect ? t("effect", { effect: said(effect) }) : "", said(reason)].filter(Boolean).join(" ");
}

/** The announcement for screen readers when a command has ended. */
export function spoken(entry) {
  const values = { action: actionText(entry), target: targetText(entry), status: statusText(entry) };
  const told = toldOf(entry);
  values.reason = told.charAt(0).toUpperCase() + told.slice(1);
  return entry.error_mm === null ? t("said", values) : t("said_error", { ...values, error: entry.error_mm.toFixed(2) });
}
