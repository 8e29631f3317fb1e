// State of this page: user, machine, selection; and whether an action is possible now.

import { say } from "../elements/dom.js";
import { Link } from "./link.js";
import { said } from "../language/said.js";
import { has, t } from "../language/strings.js";
import { Video } from "../picture/video.js";

const AT_WORK = ["moving", "looking", "touching"]; // of the controller
const REQUESTED = "driver.stop_requested"; // the banner has who or what requested the stop

class Desk {
  link = new Link();
  video = new Video(document.getElementById("picture"), this.link);
  me = { id: "", name: "", role: "viewer" };
  limits = { amber_ms: 250, max_age_ms: 500, stale_ms: 1000, jog_step_mm: 10 };
  state = null;
  selection = null;
  refused = null; // answer to the last request, if it was refused
  problemAt = 0;
  replay = false;
  frozen = false; // an earlier picture is shown over the live one
  teaching = false; // the held picture for teaching is shown over the live one
  stopping = false; // STOP was pressed here, and the machine has not been at rest since
  unstopped = false; // STOP was pressed here and has not reached the bridge or the machine
  changed = () => {};
  #lateMs = 0; // delay of the current or last input event on a busy page

  constructor() {
    for (const kind of ["pointerdown", "pointerup", "click", "keydown"]) {
      addEventListener(kind, (event) => (this.#lateMs = performance.now() - event.timeStamp), true);
    }
  }

  get mine() {
    return Boolean(this.state && this.me.id && this.state.lease.holder === this.me.id && !this.link.silent);
  }

  /** Whether this page has requested control and has no answer yet. */
  get waiting() {
    return Boolean(this.me.id) && this.state?.lease.requester === this.me.id;
  }

  /** Whether the bridge has received a STOP that the machine shows no sign of: its driver or line may hang. */
  get unheard() {
    const mayMove = ["moving", "homing", "disconnected", ""].includes(this.state?.driver.state);
    return this.stopping && mayMove && !this.link.silent && !this.replay;
  }

  /** Why the last request was refused; empty if it was not. */
  get problem() {
    return worded(this.refused);
  }

  /** The shown picture; every click and confirmation names it. */
  get seen() {
    return { camera: this.video.shown?.camera ?? this.video.camera, stamp: this.video.shown?.stamp ?? "0" };
  }

  /** Current obstacle to every motion, {code, values} as in a refusal; null without one. */
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

  /** First step of a page without control. */
  get #uncontrolled() {
    if (this.me.role === "viewer") return "role_viewer";
    if (this.waiting) return "wait_for_control";
    return this.state?.lease.holder ? "ask_first" : "no_lease";
  }

  /** Current obstacle to every gesture, or null. */
  get gestureHindrance() {
    return this.hindrance ?? this.#unready ?? this.state?.refusal ?? null;
  }

  /** The cause of a controller that is not ready, if that is no fault of the controller. */
  get #unready() {
    const { refusal, driver } = this.state ?? {};
    if (refusal?.code !== "not_ready") return null;
    if (AT_WORK.includes(refusal.values.state)) return { code: "busy_moving" };
    return driver.state === "stopped" ? { code: "reset_first" } : null; // the banner has the cause of the stop
  }

  /** Why no motion is possible now; empty if it is. */
  get whyNoMotion() {
    return worded(this.hindrance);
  }

  /** Why no gesture is possible now; empty if it is. */
  get whyNot() {
    return worded(this.gestureHindrance);
  }

  /** Send a request; show and announce a refusal. A delayed press is refused: the display has changed since. */
  async ask(type, fields = {}) {
    const late = { late_ms: Math.round(this.#lateMs), limit_ms: this.limits.max_age_ms };
    const movesNothing = type === "lease" || fields.service === "disable";
    if (late.late_ms > late.limit_ms && !movesNothing) return this.refuse({ code: "press_late", values: late });
    return this.report(await this.link.ask(type, fields));
  }

  /** Select something in the shown picture; refused while another picture covers the live one. */
  async select(what) {
    const held = (this.frozen && "frozen_no_action") || (this.teaching && "teaching_no_action");
    if (held || !this.mine) return this.refuse(held ? { code: held } : this.hindrance);
    return this.ask("select", { ...this.seen, ...what });
  }

  /** Show and announce what prevents an action. The display is up to 100 ms old: a button may still be enabled. */
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
  const name = values.state && has(`state_${values.state}`) ? t(`state_${values.state}`, { reason: said(values.reason) }) : values.state;
  const role = values.role ? t(`role_name_${values.role}`) : "";
  const field = values.field ? t(`field_${values.field}`) : "";
  const reason = values.reason && values.reason.code !== REQUESTED ? `– ${said(values.reason)}` : "";
  return { ...values, role, field, state: name, reason, what: said(values.what), step: said(values.step) };
}

export const desk = new Desk();
