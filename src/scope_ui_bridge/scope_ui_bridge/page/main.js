// Connects the parts of the page: messages from the bridge, and their display.

import { choose, wireActions } from "./orders/actions.js";
import { CommandLog, ICONS, spoken } from "./reports/command_log.js";
import { Console, showCounts } from "./reports/console.js";
import { renderGuide, sampleGuide, setFacts } from "./reports/guide.js";
import { desk } from "./connection/desk.js";
import { find, press, put, putSteady, reachable, say } from "./elements/dom.js";
import { renderDraw, wireDraw } from "./orders/draw.js";
import { renderGestures } from "./orders/gestures.js";
import { renderMove, wireMove } from "./orders/move.js";
import { relabelNumbers, wireNumbers } from "./elements/number_fields.js";
import { Overlay } from "./picture/overlay.js";
import { renderPanel, seenText, setPanel } from "./picture/panel_seen.js";
import { addError, renderPlots, sample } from "./reports/plots.js";
import { records, renderRecordings, setRecordings } from "./reports/recordings.js";
import { renderSequence, setSequence, setSequences, wireSequence } from "./orders/sequence.js";
import { said } from "./language/said.js";
import { renderStay, wireStay } from "./connection/stay.js";
import { banner, chip, stateChip } from "./elements/status.js";
import { stopBanner } from "./reports/stop_cause.js";
import { keepLanguage, language, startLanguage, t } from "./language/strings.js";
import { wireTabs } from "./elements/tabs.js";
import { relabelTeach, renderTeach, setHeld, taught, wireTeach } from "./orders/teach.js";
import { renderTools, showLive, wireTools } from "./picture/tools.js";
import { COMPUTED } from "./picture/video.js";

const KEEP_ALIVE_MS = 200;
const READ_MS = 1000;
const UNDER_WAY = ["sent", "accepted"];
const AT_REST = ["stopped", "alarm", "unhomed"]; // after STOP; the last one if the driver was restarted

const SLOW_SIMULATION = 0.9;
startLanguage();
const { link, video } = desk;
const overlay = new Overlay(find("stage"), find("overlay"), find("controls"), seenText);
const log = new CommandLog(find("log"));
const lines = new Console(find("console-lines"));
let instrument = ""; // name of the instrument
let known = false; // the first message of the bridge has arrived
let labelled = false; // whether the controls' names include their seen state, which needs a link
let counts = {}; // the driver's counters
let lostControl = false;
let wasMine = false;
let turnedAway = "";
let last = null; // entry of the last command that was no stop
let boot = ""; // id of the bridge's run of that entry
let declinedBy = ""; // the holder of control that declined this page's request
let overtakenBy = ""; // whose request has replaced this page's
desk.changed = render;

// --- what comes from the bridge ------------------------------------------------------------------------------------

link.addEventListener("hello", ({ detail }) => {
  if (known) video.renew(); // if this connection was hanging, the video's hangs as well
  turnedAway = "";
  known = true;
  desk.me = detail.you;
  desk.replay = detail.replay;
  showFacts(detail);
  setPanel(detail.panel);
  setSequences(detail.sequences, detail.sequence, detail.robot);
  setRecordings(detail.recordings);
  desk.limits = detail.limits;
  if (detail.title) {
    delete find("title").dataset.text; // the title is the instrument's name in any language
    find("title").textContent = detail.title;
    instrument = detail.title;
  }
  entitle();
  find("tab-console").hidden = find("tab-teach").hidden = desk.me.role !== "engineer";
  log.reset(detail.log);
  catchUp(detail);
  lines.reset(detail.console);
  setSelection(detail.selection);
  setState(detail.state);
});
link.addEventListener("limits", ({ detail }) => {
  desk.limits = detail.limits;
});
link.addEventListener("facts", ({ detail }) => showFacts(detail));
link.addEventListener("sequence", ({ detail }) => setSequence(detail.sequence));
link.addEventListener("recordings", ({ detail }) => setRecordings(detail.recordings));
link.addEventListener("held", ({ detail }) => setHeld(detail));
link.addEventListener("taught", ({ detail }) => taught(detail));
link.addEventListener("panel", ({ detail }) => {
  setPanel(detail.controls);
  overlay.relabel();
});
link.addEventListener("state", ({ detail }) => setState(detail));
link.addEventListener("selection", ({ detail }) => setSelection(detail.selection));
link.addEventListener("console", ({ detail }) => lines.add(detail.lines));
link.addEventListener("log", ({ detail: { entry } }) => {
  log.show(entry);
  if (entry.action !== "stop") showLast(entry);
  if (entry.action === "teach" && ["failed", "no_answer"].includes(entry.status)) taught({ ok: false, reason: spoken(entry) });
  if (UNDER_WAY.includes(entry.status)) return;
  if (entry.action === "stop" && entry.status !== "done" && !desk.replay) desk.unstopped = true;
  // A refusal during a command is removed at the command's end, once there was time to read it.
  if (performance.now() - desk.problemAt > READ_MS) desk.refused = null;
  addError(entry);
  say(spoken(entry), entry.action === "stop" || ["aborted", "failed", "no_answer"].includes(entry.status));
});
link.addEventListener("answer", ({ detail }) => {
  desk.report(detail);
  if (!link.open) turnedAway = desk.problem; // refused before the connection was accepted
});
link.addEventListener("lost", () => {
  if (desk.state) desk.state.lease = { ...desk.state.lease, holder: "", holder_name: "" };
  render();
});
video.addEventListener("frame", ({ detail }) => {
  overlay.frame(detail);
  find("stage").classList.remove("empty");
});
overlay.addEventListener("controls", showChoices);
showChoices();
overlay.addEventListener("choose", ({ detail }) => choose(detail));

function entitle() {
  document.title = instrument ? `${instrument} – ${t("product")}` : t("product");
}

function showChoices() {
  const { missing } = overlay;
  const options = [new Option(t(missing ? "choose_nothing" : "choose_placeholder"), "")];
  if (missing) {
    const why = new Option(t(`missing_${missing}`));
    why.disabled = true;
    options.push(why);
  }
  const sorted = [...overlay.controls].sort((a, b) => a.label.localeCompare(b.label));
  for (const control of sorted) if (control.kind !== "connector") options.push(new Option(control.label, control.name));
  find("chooser").replaceChildren(...options);
  find("chooser").value = desk.selection?.control ?? "";
}

function setState(next) {
  const before = desk.state?.lease.requester;
  desk.state = next;
  if (AT_REST.includes(next.driver.state)) desk.stopping = false;
  const mine = next.lease.holder === desk.me.id;
  const { holder, requester } = next.lease;
  if (holder) lostControl = false;
  else if (wasMine) lostControl = true;
  if (before === desk.me.id && requester === "" && holder !== desk.me.id) declinedBy = holder;
  if (requester === desk.me.id || holder !== declinedBy) declinedBy = "";
  if (before === desk.me.id && requester !== before && holder !== before) overtakenBy = requester;
  if (requester !== overtakenBy) overtakenBy = "";
  wasMine = mine;
  render();
}

function showFacts({ facts }) {
  setFacts(facts);
  counts = facts.driver;
  showCounts(counts);
}

/** Programs whose trajectories and heartbeats the driver accepts. */
function movedBy() {
  const { trajectories_from: program, heartbeats_from: operator } = counts ?? {};
  return program ? t("moved_by", { program, operator: operator || "–" }) : "";
}

function setSelection(next) {
  const isNew = next && next.number !== desk.selection?.number;
  desk.selection = next;
  overlay.select(next);
  find("chooser").value = next?.control ?? "";
  render();
  if (isNew) showCard();
}

/** Scroll a scrolling desk back to the selection: people must see what they confirm. */
function showCard() {
  const card = find("selection-card");
  const column = card.parentElement;
  const above = card.getBoundingClientRect().top - column.getBoundingClientRect().top;
  if (above < 0) column.scrollTop += above; // stays 0 for a column that does not scroll
}

// --- what is looked at ---------------------------------------------------------------------------------------------

for (const button of document.querySelectorAll("[data-camera]")) {
  button.addEventListener("click", () => {
    if (button.dataset.camera !== video.camera) showLive(); // outlines must match the picture's camera
    video.look({ camera: button.dataset.camera });
    overlay.forget(...COMPUTED);
    press(button, true);
    for (const other of button.parentElement.children) if (other !== button) press(other, false);
    render();
  });
}
for (const button of document.querySelectorAll("[data-layer]")) {
  const apply = () => {
    const on = button.getAttribute("aria-pressed") === "true";
    find("stage").classList.toggle(`without-${button.dataset.layer}`, !on);
    if (!COMPUTED.includes(button.dataset.layer)) return;
    video.look({ [button.dataset.layer]: on });
    overlay.forget(button.dataset.layer);
  };
  apply();
  button.addEventListener("click", () => {
    press(button, button.getAttribute("aria-pressed") !== "true");
    apply();
  });
}
find("language").addEventListener("click", () => {
  keepLanguage(language() === "en" ? "de" : "en");
  entitle();
  overlay.relabel();
  showChoices();
  log.relabel();
  if (last) showLast(last);
  relabelTeach();
  relabelNumbers();
  render();
});

// --- what is shown -------------------------------------------------------------------------------------------------

/** Show the last command's result next to the buttons that gave it. */
function showLast(entry) {
  last = entry;
  const element = find("last");
  element.hidden = false;
  element.dataset.status = entry.status;
  element.firstElementChild.textContent = ICONS[entry.status] ?? "";
  element.lastElementChild.textContent = spoken(entry);
}

/** The last command may have ended while the link was lost; another run of the bridge has no entry of it. */
function catchUp({ boot: run, log: entries }) {
  if (last && UNDER_WAY.includes(last.status)) {
    const known = run === boot && entries.find(({ entry }) => entry === last.entry);
    showLast(known || { ...last, status: "no_answer" });
    if (!UNDER_WAY.includes(last.status)) say(spoken(last), true);
  }
  boot = run;
}

function render() {
  const { state, me } = desk;
  if (!state) return;
  const focused = document.activeElement;
  for (const part of ["driver", "controller", "calibration"]) {
    const more = part === "driver" && !link.silent ? movedBy() : "";
    stateChip(`chip-${part}`, link.silent ? { state: "", reason: "" } : state[part], more);
  }
  const seen = state.confidence > 0;
  const unsure = ["panel_not_seen", "low_confidence", "recognition_silent"].includes(state.refusal?.code);
  if (link.silent || state.refusal?.code === "recognition_silent") {
    chip("chip-recognition", "none", t("unknown"));
  } else {
    chip(
      "chip-recognition",
      unsure || !seen ? "waiting" : "good",
      seen ? t("recognised", { percent: Math.round(100 * state.confidence) }) : t("not_recognised"),
    );
  }
  find("stage").classList.toggle("unsure", unsure || !seen);
  find("stage").classList.toggle("moving", state.moving);
  put(find("you"), t("you", { name: me.name, count: state.viewers }));
  find("you").title = me.name;
  ["x", "y", "stylus"].forEach((axis, index) => {
    const value = link.silent ? NaN : state.position_mm?.[index];
    put(find(`position-${axis}`), Number.isFinite(value) ? t("mm", { value: value.toFixed(1) }) : "–");
  });
  renderLease();
  renderSelection();
  renderMachine();
  renderPanel(overlay.controls);
  if (labelled === link.silent) {
    overlay.relabel();
    showCounts(link.silent ? {} : counts);
  }
  labelled = !link.silent;
  renderMove();
  renderSequence();
  renderTeach();
  renderTools();
  renderStay();
  renderRecordings();
  log.watch();
  renderAge();
  keepFocus(focused);
}

/** A disabled or hidden element would lose the focus: its card takes it, where a second Enter does nothing. */
function keepFocus(at) {
  if (!at.matches(":disabled") && at.getClientRects().length) return;
  const whole = find("desk").getClientRects().length ? find("desk") : find("lease-card"); // not on a telephone
  const place = at.closest('[role="tabpanel"], .card') ?? whole;
  place.tabIndex = -1;
  place.focus({ preventScroll: true });
}

let beneath = null; // the control that had the focus when the picture became too old to show it

function keepFocusBeneath(stale) {
  const at = document.activeElement;
  if (stale) beneath = at.closest("#controls button") ?? beneath;
  else if (beneath) {
    if (at === document.body) beneath.focus({ preventScroll: true });
    beneath = null;
  }
}

/** Tabs of one browser, and browsers with one account, have the same name. */
const called = (name) => (name === desk.me.name ? t("other_page", { name }) : name);

function renderLease() {
  const { me, mine } = desk;
  const { holder, requester } = desk.state.lease;
  const [name, asking] = [desk.state.lease.holder_name, desk.state.lease.requester_name].map(called);
  const asked = mine && requester;
  const may = me.role !== "viewer" && !desk.replay;
  let text = mine ? t("lease_mine") : holder ? t("lease_other", { name }) : t("lease_free");
  if (declinedBy) text = t("lease_declined", { name });
  if (overtakenBy) text = t("lease_overtaken", { name: asking });
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

function renderSelection() {
  const { selection } = desk;
  const reason = desk.whyNot;
  find("selection-card").dataset.look = selection ? "chosen" : "";
  find("selection-card").dataset.kind = selection?.kind ?? "";
  put(find("selection-name"), selection ? selection.label || t(selection.to_mm ? "selection_a_line" : "selection_point") : t("selection_none"));
  const [x, y] = selection?.panel_mm ?? [];
  const seen = seenText(selection?.control);
  const detail = selection?.to_mm
    ? t("selection_line", { x: x.toFixed(1), y: y.toFixed(1), to_x: selection.to_mm[0], to_y: selection.to_mm[1] })
    : selection && t("selection_detail", { kind: t(`kind_${selection.kind}`), x: x?.toFixed(1), y: y?.toFixed(1) });
  put(find("selection-detail"), detail ? `${detail}${seen && ` · ${seen}`}` : t(overlay.missing ? `missing_${overlay.missing}` : "selection_hint"));
  renderGestures();
  renderDraw(overlay.controls);
  find("clear").hidden = !selection;
  find("clear").disabled = !desk.mine;
  const element = find("refusal");
  if (desk.problem) put(element, desk.problem);
  else putSteady(element, selection || !desk.mine ? reason : "");
  element.dataset.look = desk.problem ? "bad" : "";
  reachable(find("verdict"));
}

function renderMachine() {
  const { driver, moving } = desk.state;
  for (const button of document.querySelectorAll("[data-call]")) {
    const { call } = button.dataset;
    const inVain = (call === "record" && records()) || (call === "end_record" && !records());
    button.disabled = !desk.mine || inVain || (moving && !["disable", "record", "end_record"].includes(call));
  }
  find("reset").hidden = !["stopped", "alarm", "mismatch"].includes(driver.state);
  find("accept").hidden = driver.state !== "mismatch" || desk.me.role !== "engineer";
  renderGuide();
}

/** Show that a simulation is slower than real time; the pictures' ages are in simulated time. */
function renderSimulation() {
  const factor = desk.state?.simulation_factor ?? 1;
  video.factor = Math.min(factor, 1);
  find("chip-simulation").hidden = factor >= SLOW_SIMULATION;
  if (factor >= SLOW_SIMULATION) return;
  const text = t("simulation_slow", { factor: factor.toLocaleString(language()) });
  chip("chip-simulation", "waiting", text, `${t("chip_simulation")} ${text}`);
}

const calibrating = () => desk.state && t("banner_calibrating", { progress: said(desk.state.calibration.reason) });

function renderAge() {
  const { limits, state } = desk;
  renderSimulation();
  const age = video.ageMs;
  const stage = find("stage");
  const stale = age > limits.stale_ms;
  stage.dataset.age = stale ? "stale" : age > limits.max_age_ms ? "old" : age > limits.amber_ms ? "late" : "live";
  const look = { stale: "bad", old: "bad", late: "waiting", live: "good" }[stage.dataset.age];
  const shown = Number.isFinite(age);
  chip("chip-video", look, shown ? t("live", { age: Math.round(age) }) : t("no_picture"));
  put(find("chip-video").querySelector("dt"), t(video.shown?.light ? "chip_video_light" : "chip_video"));
  put(find("age"), shown && !stale ? t("live", { age: Math.round(age) }) : "");
  find("stale").hidden = !stale;
  keepFocusBeneath(stale);
  if (stale) put(find("stale"), shown ? t("stale", { age: (age / 1000).toFixed(1) }) : t("no_picture"));
  const silent = link.silent;
  const rtt = link.rttMs === null ? "–" : Math.round(link.rttMs);
  chip("chip-link", silent ? "bad" : "good", silent ? t("link_lost") : t("link_ok", { rtt }));
  const { state: driver, reason } = state?.driver ?? {};
  const asking = desk.mine && state.lease.requester ? called(state.lease.requester_name) : "";
  const viewing = desk.waiting ? "wait_for_control" : state?.lease.holder ? "banner_viewing_other" : "banner_viewing";
  if (AT_REST.includes(driver) && !silent) desk.unstopped = false;
  banner(find("banner"), [
    { when: desk.unstopped, look: "bad", text: t("banner_stop_failed") },
    { when: turnedAway, look: "bad", text: turnedAway },
    { when: silent, look: "bad", text: t(wasMine ? "banner_link" : "banner_link_viewer") },
    { when: desk.replay, look: "waiting", text: t("banner_replay") },
    { when: driver === "alarm", look: "bad", text: t("banner_alarm", { reason: said(reason) }) },
    { when: driver === "stopped", look: "bad", text: state && stopBanner(state), beside: t("banner_until_reset") },
    { when: age > limits.max_age_ms, look: "waiting", text: t(state?.moving ? "banner_moving_stale" : "banner_stale") },
    { when: state?.calibration.state === "calibrating", look: "busy", text: calibrating() },
    { when: state?.moving, look: "busy", text: t("banner_moving") },
    { when: asking, look: "waiting", text: t("lease_asked", { name: asking }) },
    { when: lostControl, look: "waiting", text: t("banner_lost_control") },
    { when: !state, look: "none", text: t("banner_connecting") },
    { when: !desk.mine, look: "none", text: t(desk.me.role === "viewer" ? "role_viewer" : viewing) },
    { when: state?.refusal || desk.frozen || desk.teaching, look: "waiting", text: t("banner_waiting", { reason: desk.whyNot }) },
    { when: true, look: "good", text: t("banner_ready") },
  ]);
}

// --- the beat: keep-alives come from animation frames, so a hidden or frozen page stops the machine -------------------

let seen = false; // the current motion has been visible, at its start or since
function watchMotion() {
  const moving = desk.mine && desk.state.moving;
  const blindMs = video.blindMs;
  const blind = blindMs > desk.limits.stale_ms;
  // A motion that started without a picture needs none, such as homing.
  if (moving && blind && seen) link.blind(blindMs);
  seen = moving && !blind;
}

let lastAlive = -Infinity;
let lastShown = -Infinity;
let lastPlotted = -Infinity;
function beat(now) {
  if (now - lastAlive >= KEEP_ALIVE_MS - 8) {
    lastAlive = now;
    link.alive();
  }
  if (now - lastShown >= 100) {
    lastShown = now;
    link.watch();
    video.watch();
    watchMotion();
    if (desk.state) render();
    else renderAge();
  }
  if (now - lastPlotted >= 250) {
    lastPlotted = now;
    sample(now);
    sampleGuide();
    renderPlots(now);
  }
  requestAnimationFrame(beat);
}

window.addEventListener("pagehide", () => link.leave()); // before it is hidden
// A hidden page has no animation frames; it reports that it is hidden, so that the stop's cause is known.
document.addEventListener("visibilitychange", () => document.visibilityState === "hidden" && link.hide());

wireActions();
wireDraw(overlay);
wireMove();
wireNumbers();
wireSequence();
wireStay();
wireTools();
wireTeach();
wireTabs(find("tabs"));
log.wireSearch(find("log-search"), find("log-found"), find("log-export"));
if (location.search) history.replaceState(null, "", "/"); // removes the used token from the address bar
link.connect();
video.connect();
requestAnimationFrame(beat);
