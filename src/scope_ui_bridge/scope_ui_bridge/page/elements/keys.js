// Single-key shortcuts. People who dictate or tremble can switch them off (WCAG 2.1.4).

import { find } from "./dom.js";

const KEPT = "single_keys";

/** Return the character typed as a shortcut, or an empty text. */
export function singleKey(event) {
  if (!find("single-keys").checked || event.target.closest("input, select, textarea")) return "";
  // On many keyboards brackets need AltGr, which is reported as Ctrl and Alt on some systems, or a Mac's Option key.
  const written = "[]".includes(event.key) && !event.metaKey && (event.getModifierState("AltGraph") || !event.ctrlKey);
  if (!written && (event.ctrlKey || event.altKey || event.metaKey)) return "";
  return event.key.toLowerCase();
}

export function wireSingleKeys() {
  const box = find("single-keys");
  box.checked = localStorage.getItem(KEPT) !== "off";
  box.addEventListener("change", () => localStorage.setItem(KEPT, box.checked ? "on" : "off"));
}
