// What this page knows: who we are, the machine's state, the selection; and whether anything may be done with it now.

import { say } from "./dom.js";
import { Link } from "./link.js";
import { said } from "./said.js";
import { has, t } from "./strings.js";
import { Video } from "./video.js";

const REQUESTED = "stop requested"; // the driver knows no more; the banner says who or what asked

class Desk {
  link = new Link();
  video = new Video(document.getElementById("picture"), this.link);
  me = { id: "", name: "", role: "viewer" };
  limits = { amber_ms: 250, max_age_ms: 500, stale_ms: 1000, jog_step_mm: 10 };
  state = null;
  selection = null;
  refused = null; // the answer to what was asked for last, when it was a refusal
  problemAt = 0;
  replay = false;
  frozen = false; // the picture before is held over the live one
  teaching = false; // the picture that a panel is pointed at in lies over the live one
  unstopped = false; // STOP was pressed here and has not got through
  changed = () => {};

  get mine() {
    return Boolean(this.state && this.me.id && this.state.lease.holder === this.me.id && !this.link.silent);
  }

  /** Why the last thing that was asked for was refused; empty when it was not. */
  get problem() {
    return this.refused ? t(this.refused.code, explained(this.refused.values)) : "";
  }

  /** The picture that is being looked at; every click and confirmation names it. */
  get seen() {
    return { camera: this.video.shown?.camera ?? this.video.camera, stamp: this.video.shown?.stamp ?? "0" };
  }

  /** Why nothing can be moved at all now; empty when it can. */
  get whyNoMotion() {
    if (this.link.silent) return t("link_down");
    if (this.replay) return t("replay");
    if (!this.mine) return t(this.me.role === "viewer" ? "role_viewer" : "no_lease");
    if (this.frozen) return t("frozen_no_action");
    if (this.teaching) return t("teaching_no_action");
    const age = this.video.ageMs;
    if (!(age <= this.limits.max_age_ms)) {
      return t("picture_late", { age_ms: Number.isFinite(age) ? Math.round(age) : "?", limit_ms: this.limits.max_age_ms });
    }
    return "";
  }

  /** Why no gesture can be done now; empty when it can. */
  get whyNot() {
    const refusal = this.state?.refusal;
    return this.whyNoMotion || (refusal ? t(refusal.code, explained(refusal.values)) : "");
  }

  /** Ask the bridge; a refusal is shown and said. */
  async ask(type, fields = {}) {
    return this.report(await this.link.ask(type, fields));
  }

  /** Select something of the picture that is being looked at, which is not the live one while another lies over it. */
  async select(what) {
    const held = (this.frozen && "frozen_no_action") || (this.teaching && "teaching_no_action");
    return held ? this.report({ ok: false, code: held }) : this.ask("select", { ...this.seen, ...what });
  }

  report(answer) {
    this.refused = answer.ok ? null : answer;
    this.problemAt = performance.now();
    if (this.problem) say(this.problem, true);
    this.changed();
    return answer.ok;
  }
}

/** Sentences show the state's name in the page's language. */
function explained(values = {}) {
  const name = values.state && has(`state_${values.state}`) ? t(`state_${values.state}`, values) : values.state;
  const role = values.role ? t(`role_name_${values.role}`) : "";
  const field = values.field ? t(`field_${values.field}`) : "";
  const reason = values.reason && values.reason !== REQUESTED ? `– ${said(values.reason)}` : "";
  return { ...values, role, field, state: name, reason, what: said(values.what), step: said(values.step) };
}

export const desk = new Desk();
