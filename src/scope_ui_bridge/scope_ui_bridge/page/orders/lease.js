// Control: whether this page has it, who else has it or requests it, and the outcome of a request.

import { desk } from "../connection/desk.js";
import { find, put } from "../elements/dom.js";
import { t } from "../language/strings.js";

/** Last changes of control, shown for as long as people need to read them. */
export const control = {
  lost: false, // this page has lost control, and no page has it
  had: false, // this page had control in the last state
  declinedBy: "", // the holder of control that declined this page's request
  overtakenBy: "", // whose request has replaced this page's
};

/** Compare the next state with the present one; call before it becomes the present one. */
export function followControl(next) {
  const before = desk.state?.lease.requester;
  const { holder, requester } = next.lease;
  if (holder) control.lost = false;
  else if (control.had) control.lost = true;
  if (before === desk.me.id && requester === "" && holder !== desk.me.id) control.declinedBy = holder;
  if (requester === desk.me.id || holder !== control.declinedBy) control.declinedBy = "";
  if (before === desk.me.id && requester !== before && holder !== before) control.overtakenBy = requester;
  if (requester !== control.overtakenBy) control.overtakenBy = "";
  control.had = holder === desk.me.id;
}

/** Tabs of one browser, and browsers with one account, have the same name. */
export const called = (name) => (name === desk.me.name ? t("other_page", { name }) : name);

export function renderLease() {
  const { me, mine } = desk;
  const { holder, requester } = desk.state.lease;
  const [name, asking] = [desk.state.lease.holder_name, desk.state.lease.requester_name].map(called);
  const asked = mine && requester;
  const may = me.role !== "viewer" && !desk.replay;
  let text = mine ? t("lease_mine") : holder ? t("lease_other", { name }) : t("lease_free");
  if (control.declinedBy) text = t("lease_declined", { name });
  if (control.overtakenBy) text = t("lease_overtaken", { name: asking });
  if (asked) text = t("lease_asked", { name: asking });
  if (desk.waiting) text = t("lease_waiting", { name });
  if (desk.link.silent) text = t("link_down"); // the present holder of control is unknown
  put(find("lease-text"), text);
  find("lease-text").dataset.asking = asked ? requester : "";
  find("lease-card").dataset.look = mine ? "mine" : "";
  if (desk.link.silent) return; // nothing moves on the page, and no action is possible
  find("lease-take").hidden = Boolean(holder) || !may;
  find("lease-request").hidden = !holder || mine || !may;
  find("lease-request").disabled = desk.waiting;
  find("lease-withdraw").hidden = !desk.waiting;
  find("lease-release").hidden = !mine;
  find("lease-grant").hidden = find("lease-decline").hidden = !asked;
}
