// The age of the picture, the quality of the link, and the most urgent sentence of the page.

import { desk } from "../connection/desk.js";
import { find, put } from "../elements/dom.js";
import { keepFocusBeneath } from "../elements/focus.js";
import { banner, chip } from "../elements/status.js";
import { said } from "../language/said.js";
import { language, t } from "../language/strings.js";
import { called, control } from "../orders/lease.js";
import { stopBanner } from "./stop_cause.js";

const AT_REST = ["stopped", "alarm", "unhomed"]; // after STOP; the last one if the driver was restarted
const SLOW_SIMULATION = 0.9;
let turnedAway = ""; // why the bridge has not accepted the connection

/** Show why the bridge has not accepted the connection; empty if it has. */
export function setTurnedAway(why) {
  turnedAway = why;
}

/** Whether the machine is at rest after STOP. */
export const isAtRest = (driver) => AT_REST.includes(driver.state);

/** Show that a simulation is slower than real time; the pictures' ages are in simulated time. */
function renderSimulation() {
  const factor = desk.state?.simulation_factor ?? 1;
  desk.video.factor = Math.min(factor, 1);
  find("chip-simulation").hidden = factor >= SLOW_SIMULATION;
  if (factor >= SLOW_SIMULATION) return;
  const text = t("simulation_slow", { factor: factor.toLocaleString(language()) });
  chip("chip-simulation", "waiting", text, `${t("chip_simulation")} ${text}`);
}

const calibrating = () => desk.state && t("banner_calibrating", { progress: said(desk.state.calibration.reason) });

export function renderAge() {
  const { limits, state } = desk;
  renderSimulation();
  const age = desk.video.ageMs;
  const stage = find("stage");
  const stale = age > limits.stale_ms;
  stage.dataset.age = stale ? "stale" : age > limits.max_age_ms ? "old" : age > limits.amber_ms ? "late" : "live";
  const look = { stale: "bad", old: "bad", late: "waiting", live: "good" }[stage.dataset.age];
  const shown = Number.isFinite(age);
  chip("chip-video", look, shown ? t("live", { age: Math.round(age) }) : t("no_picture"));
  put(find("chip-video").querySelector("dt"), t(desk.video.shown?.light ? "chip_video_light" : "chip_video"));
  put(find("age"), shown && !stale ? t("live", { age: Math.round(age) }) : "");
  find("stale").hidden = !stale;
  keepFocusBeneath(stale);
  if (stale) put(find("stale"), shown ? t("stale", { age: (age / 1000).toFixed(1) }) : t("no_picture"));
  const silent = desk.link.silent;
  const rtt = desk.link.rttMs === null ? "–" : Math.round(desk.link.rttMs);
  chip("chip-link", silent ? "bad" : "good", silent ? t("link_lost") : t("link_ok", { rtt }));
  const { state: driver, reason } = state?.driver ?? {};
  const asking = desk.mine && state.lease.requester ? called(state.lease.requester_name) : "";
  const viewing = desk.waiting ? "wait_for_control" : state?.lease.holder ? "banner_viewing_other" : "banner_viewing";
  if (AT_REST.includes(driver) && !silent) desk.unstopped = false;
  banner(find("banner"), [
    { when: desk.unstopped, look: "bad", text: t("banner_stop_failed") },
    { when: turnedAway, look: "bad", text: turnedAway },
    { when: silent, look: "bad", text: t(control.had ? "banner_link" : "banner_link_viewer") },
    { when: desk.replay, look: "waiting", text: t("banner_replay") },
    { when: driver === "alarm", look: "bad", text: t("banner_alarm", { reason: said(reason) }) },
    { when: driver === "stopped", look: "bad", text: state && stopBanner(state), beside: t("banner_until_reset") },
    { when: age > limits.max_age_ms, look: "waiting", text: t(state?.moving ? "banner_moving_stale" : "banner_stale") },
    { when: state?.calibration.state === "calibrating", look: "busy", text: calibrating() },
    { when: state?.moving, look: "busy", text: t("banner_moving") },
    { when: asking, look: "waiting", text: t("lease_asked", { name: asking }) },
    { when: control.lost, look: "waiting", text: t("banner_lost_control") },
    { when: !state, look: "none", text: t("banner_connecting") },
    { when: !desk.mine, look: "none", text: t(desk.me.role === "viewer" ? "role_viewer" : viewing) },
    { when: state?.refusal || desk.frozen || desk.teaching, look: "waiting", text: t("banner_waiting", { reason: desk.whyNot }) },
    { when: true, look: "good", text: t("banner_ready") },
  ]);
}
