// What this page knows: who we are, the machine's state, the selection; and whether anything may be done with it now.

import { say } from "./dom.js";
import { Link } from "./link.js";
import { said } from "./said.js";
import { has, t } from "./strings.js";
import { Video } from "./video.js";

const AT_WORK = ["moving", "looking", "touching"]; // of the controller
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
  stopping = false; // STOP was pressed here, and the machine has not been seen at rest since
  unstopped = false; // STOP was pressed here and has not got through, to the bridge or to the machine
  changed = () => {};
  #lateMs = 0; // how long the press that is answered now, or was last, had to wait for a page that was held up

  constructor() {
    for (const kind of ["pointerdown", "pointerup", "click", "keydown"]) {
      addEventListener(kind, (event) => (this.#lateMs = performance.now() - event.timeStamp), true);
    }
  }

  get mine() {
    return Boolean(this.state && this.me.id && this.state.lease.holder === this.me.id && !this.link.silent);
  }

  /** Whether this page has asked for control and has no answer yet. */
  get waiting() {
    return Boolean(this.me.id) && this.state?.lease.requester === this.me.id;
  }

  /** Whether a STOP that the bridge has heard is not seen to be heard by the machine: its driver or its line may hang. */
  get unheard() {
    const mayMove = ["moving", "homing", "disconnected", ""].includes(this.state?.driver.state);
    return this.stopping && mayMove && !this.link.silent && !this.replay;
  }

  /** Why the last thing that was asked for was refused; empty when it was not. */
  get problem() {
    return worded(this.refused);
  }

  /** The picture that is being looked at; every click and confirmation names it. */
  get seen() {
    return { camera: this.video.shown?.camera ?? this.video.camera, stamp: this.video.shown?.stamp ?? "0" };
  }

  /** What keeps everything from moving now, {code, values} as in a refusal; null when nothing does. */
  get hindrance() {
    if (this.link.silent) return { code: "link_down" };
    if (this.replay) return { code: "replay" };
    if (!this.mine) return { code: this.#uncontrolled };
    if (this.frozen) return { code: "frozen_no_action" };
    if (this.teaching) return { code: "teaching_no_action" };
    const age = this.video.ageMs;
    if (age <= this.limits.max_age_ms) return null;
    return { code: "picture_late", values: { age_ms: Number.isFinite(age) ? Math.round(age) : "?", limit_ms: this.limits.max_age_ms } };
  }

  /** Why a page that is not in control has to do something else first. */
  get #uncontrolled() {
    if (this.me.role === "viewer") return "role_viewer";
    if (this.waiting) return "wait_for_control";
    return this.state?.lease.holder ? "ask_first" : "no_lease";
  }

  /** What keeps every gesture from being done now. */
  get gestureHindrance() {
    return this.hindrance ?? this.#unready ?? this.state?.refusal ?? null;
  }

  /** What is meant by a controller that is not ready, where that is no fault of it. */
  get #unready() {
    const { refusal, driver } = this.state ?? {};
    if (refusal?.code !== "not_ready") return null;
    if (AT_WORK.includes(refusal.values.state)) return { code: "busy_moving" };
    return driver.state === "stopped" ? { code: "reset_first" } : null; // the banner says why it has stopped
  }

  /** Why nothing can be moved at all now; empty when it can. */
  get whyNoMotion() {
    return worded(this.hindrance);
  }

  /** Why no gesture can be done now; empty when it can. */
  get whyNot() {
    return worded(this.gestureHindrance);
  }

  /** Ask the bridge; a refusal is shown and said. What was pressed long ago was not meant for what is shown now. */
  async ask(type, fields = {}) {
    const late = { late_ms: Math.round(this.#lateMs), limit_ms: this.limits.max_age_ms };
    const movesNothing = type === "lease" || fields.service === "disable";
    if (late.late_ms > late.limit_ms && !movesNothing) return this.refuse({ code: "press_late", values: late });
    return this.report(await this.link.ask(type, fields));
  }

  /** Select something of the picture that is being looked at, which is not the live one while another lies over it. */
  async select(what) {
    const held = (this.frozen && "frozen_no_action") || (this.teaching && "teaching_no_action");
    if (held || !this.mine) return this.refuse(held ? { code: held } : this.hindrance);
    return this.ask("select", { ...this.seen, ...what });
  }

  /** Show and say what keeps it from being done. What is drawn is up to 100 ms old: a button may have been enabled still. */
  refuse({ code, values = {} }) {
    return this.report({ ok: false, code, values });
  }

  report(answer) {
    this.refused = answer.ok ? null : answer;
    this.problemAt = performance.now();
    if (this.problem) say(this.problem, true);
    this.changed();
    return answer.ok;
  }
}

const worded = (refusal) => (refusal ? t(refusal.code, explained(refusal.values)) : "");

/** Sentences show the state's name in the page's language. */
function explained(values = {}) {
  const name = values.state && has(`state_${values.state}`) ? t(`state_${values.state}`, values) : values.state;
  const role = values.role ? t(`role_name_${values.role}`) : "";
  const field = values.field ? t(`field_${values.field}`) : "";
  const reason = values.reason && values.reason !== REQUESTED ? `– ${said(values.reason)}` : "";
  return { ...values, role, field, state: name, reason, what: said(values.what), step: said(values.step) };
}

export const desk = new Desk();
