// The command log: newest first, each command one row that is updated until its result is known.

import { has, t } from "./strings.js";

export const ICONS = {
  sent: "…", accepted: "▶", reached: "✓", done: "✓", aborted: "✕", rejected: "✕", failed: "✕", no_answer: "?",
};
const MAX_ROWS = 200;

export class CommandLog {
  #body;
  #rows = new Map();

  constructor(body) {
    this.#body = body;
    this.reset([]);
  }

  reset(entries) {
    this.#rows.clear();
    this.#body.replaceChildren();
    for (const entry of entries) this.show(entry);
    if (!entries.length) {
      const row = this.#body.insertRow();
      row.className = "nothing";
      row.insertCell().textContent = t("log_empty");
      row.cells[0].colSpan = 5;
    }
  }

  show(entry) {
    this.#body.querySelector(".nothing")?.remove();
    let row = this.#rows.get(entry.entry);
    if (!row) {
      row = this.#body.insertRow(0);
      for (let i = 0; i < 5; i += 1) row.insertCell();
      this.#rows.set(entry.entry, row);
      if (this.#body.rows.length > MAX_ROWS) this.#body.deleteRow(-1);
    }
    row.dataset.status = entry.status;
    row.dataset.action = entry.action.split(" ")[0];
    const [time, what, result, error, who] = row.cells;
    time.textContent = new Date(entry.wall_ms).toLocaleTimeString([], { hour12: false });
    what.textContent = `${actionText(entry)} ${targetText(entry)}`.trim();
    const icon = document.createElement("span");
    icon.className = "icon";
    icon.setAttribute("aria-hidden", "true");
    icon.textContent = ICONS[entry.status] ?? "";
    const text = document.createElement("strong");
    text.textContent = t(`status_${entry.status}`);
    result.replaceChildren(icon, text, entry.reason ? ` ${entry.reason}` : "");
    error.className = "number";
    error.textContent = entry.error_mm === null ? "" : t("mm", { value: entry.error_mm.toFixed(2) });
    who.className = "who";
    who.textContent = entry.who;
  }
}

export function actionText(entry) {
  const [name, argument] = entry.action.split(" ");
  if (!has(`action_${name}`)) return entry.action;
  const value = Number(argument);
  const details = { hold: ` ${value} s`, turn: ` ${value > 0 ? "↺" : "↻"} ${Math.abs(value)}°` }[name] ?? "";
  return t(`action_${name}`) + details;
}

export function targetText(entry) {
  return t(entry.target);
}

/** What a screen reader says when a command has ended. */
export function spoken(entry) {
  const values = { action: actionText(entry), target: targetText(entry), status: t(`status_${entry.status}`) };
  if (entry.error_mm !== null) return t("said_error", { ...values, error: entry.error_mm.toFixed(2) });
  return t("said", { ...values, reason: entry.reason });
}
