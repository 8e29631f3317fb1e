// The focus of the keyboard, which must not get lost with an element.

import { find } from "./dom.js";

/** A disabled or hidden element would lose the focus: its card takes it, where a second Enter does nothing. */
export function keepFocus(at) {
  if (!at.matches(":disabled") && at.getClientRects().length) return;
  const whole = find("desk").getClientRects().length ? find("desk") : find("lease-card"); // not on a telephone
  const place = at.closest('[role="tabpanel"], .card') ?? whole;
  place.tabIndex = -1;
  place.focus({ preventScroll: true });
}

let beneath = null; // the control that had the focus when the picture became too old to show it

/** Return the focus to a control of the picture once the picture is shown again. */
export function keepFocusBeneath(stale) {
  const at = document.activeElement;
  if (stale) beneath = at.closest("#controls button") ?? beneath;
  else if (beneath) {
    if (at === document.body) beneath.focus({ preventScroll: true });
    beneath = null;
  }
}
