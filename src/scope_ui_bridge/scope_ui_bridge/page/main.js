// Wires the page together: link and video in, status and overlay out, clicks and keys to the bridge.

import { CommandLog, ICONS, spoken } from "./command_log.js";
import { Link } from "./link.js";
import { Overlay } from "./overlay.js";
import { banner, chip, stateChip } from "./status.js";
import { fillTexts, has, t } from "./strings.js";
import { Video } from "./video.js";

const KEEP_ALIVE_MS = 200;
const ARMED_MS = 4000;
const find = (id) => document.getElementById(id);

fillTexts();
const link = new Link();
const video = new Video(find("picture"), link);
const overlay = new Overlay(find("stage"), find("overlay"), find("controls"));
const log = new CommandLog(find("log"));
let me = { id: "", name: "" };
let limits = { amber_ms: 250, max_age_ms: 500, stale_ms: 1000 };
let state = null;
let selection = null;
let lastBoot = "";
let restarted = false;
let lostControl = false;
let wasMine = false;
let problem = "";

// --- what comes from the bridge ------------------------------------------------------------------------------------

link.addEventListener("hello", ({ detail }) => {
  restarted = lastBoot !== "" && lastBoot !== detail.boot;
  lastBoot = detail.boot;
  me = detail.you;
  limits = detail.limits;
  if (detail.title) {
    find("title").textContent = detail.title;
    document.title = `${detail.title} – ${t("product")}`;
  }
  log.reset(detail.log);
  setSelection(detail.selection);
  setState(detail.state);
});
link.addEventListener("state", ({ detail }) => setState(detail));
link.addEventListener("selection", ({ detail }) => setSelection(detail.selection));
link.addEventListener("log", ({ detail }) => {
  log.show(detail.entry);
  if (detail.entry.action !== "stop") showLast(detail.entry);
  if (!["sent", "accepted"].includes(detail.entry.status)) {
    const urgent = ["stop"].includes(detail.entry.action) || ["aborted", "failed", "no_answer"].includes(detail.entry.status);
    say(spoken(detail.entry), urgent);
  }
});
link.addEventListener("answer", ({ detail }) => report(detail));
link.addEventListener("lost", () => {
  if (state) state.lease = { ...state.lease, holder: "", holder_name: "" };
  render();
});
video.addEventListener("frame", ({ detail }) => {
  overlay.frame(detail);
  find("stage").classList.remove("empty");
});
overlay.addEventListener("controls", () => {
  const options = [new Option(t("choose_placeholder"), "")];
  const sorted = [...overlay.controls].sort((a, b) => a.label.localeCompare(b.label));
  for (const control of sorted) if (control.kind !== "connector") options.push(new Option(control.label, control.name));
  find("chooser").replaceChildren(...options);
  find("chooser").value = selection?.control ?? "";
});
overlay.addEventListener("choose", ({ detail }) => choose(detail));

function setState(next) {
  state = next;
  const mine = state.lease.holder === me.id;
  if (mine) restarted = lostControl = false;
  if (wasMine && !mine) lostControl = true;
  wasMine = mine;
  render();
}

function setSelection(next) {
  selection = next;
  overlay.select(next);
  find("chooser").value = next?.control ?? "";
  render();
}

// --- what goes to the bridge ---------------------------------------------------------------------------------------

function frameFields() {
  return { camera: video.shown?.camera ?? video.camera, stamp: video.shown?.stamp ?? "0" };
}

function report(answer) {
  problem = answer.ok ? "" : t(answer.code, explained(answer.values));
  if (problem) say(problem, true);
  render();
  return answer.ok;
}

/** Sentences show the state's name in the page's language. */
function explained(values = {}) {
  const name = values.state && has(`state_${values.state}`) ? t(`state_${values.state}`, values) : values.state;
  return { ...values, state: name, reason: values.reason ? `– ${values.reason}` : "" };
}

async function choose({ byKey, ...what }) {
  const good = report(await link.ask("select", { ...frameFields(), ...what }));
  if (good && byKey) find("confirm").querySelector("button:not([disabled]):not([hidden])")?.focus();
}

async function act(gesture, argument) {
  if (!selection || !actionsAllowed(gesture)) return;
  const more = gesture === "press" ? {} : { argument };
  report(await link.ask("act", { gesture, selection: selection.number, ...frameFields(), ...more }));
}

function stop() {
  // Two ways at once: the open connection, and a plain request that needs nothing but the sign-in.
  // The bridge knows by the press that it is one stop.
  const press = Math.random().toString(36).slice(2);
  const way = link.ask("stop", { press });
  const other = fetch(`/stop?press=${press}`, { method: "POST", keepalive: true }).then((answer) => answer.ok, () => false);
  Promise.all([way, other]).then(([first, second]) => {
    if (!first.ok && !second) say(t("link_down"), true);
  });
}

find("stop-form").addEventListener("submit", (event) => {
  event.preventDefault();
  stop();
});
// On press, not on release: a finger that slides off has still said stop.
find("stop").addEventListener("pointerdown", stop);
find("stop").addEventListener("click", (event) => {
  if (event.detail !== 0) event.preventDefault(); // pointerdown has done it; a key comes through submit
});

for (const button of document.querySelectorAll("[data-act]")) {
  button.addEventListener("click", () => {
    const sign = Number(button.dataset.sign ?? 1);
    const value = Number(find(button.dataset.act === "hold" ? "hold-seconds" : "turn-degrees").value);
    act(button.dataset.act, button.dataset.act === "hold" ? value : sign * value);
  });
}
find("clear").addEventListener("click", async () => report(await link.ask("select", frameFields())));
find("chooser").addEventListener("change", (event) => {
  if (event.target.value) choose({ control: event.target.value, byKey: false });
});

for (const step of ["take", "request", "release", "grant", "decline"]) {
  find(`lease-${step}`).addEventListener("click", async () => report(await link.ask("lease", { step })));
}

for (const button of document.querySelectorAll("[data-call]")) {
  const service = button.dataset.call;
  let timer = 0;
  const disarm = () => {
    clearTimeout(timer);
    delete button.dataset.armed;
    button.textContent = t(`call_${service}`);
  };
  button.addEventListener("click", async () => {
    if ("twice" in button.dataset && !("armed" in button.dataset)) {
      button.dataset.armed = "";
      button.textContent = t(`confirm_${service}`);
      timer = setTimeout(disarm, ARMED_MS);
      return;
    }
    disarm();
    report(await link.ask("call", { service }));
  });
}

for (const button of document.querySelectorAll("[data-camera]")) {
  button.addEventListener("click", () => {
    video.look({ camera: button.dataset.camera });
    press(button, true);
    for (const other of button.parentElement.children) if (other !== button) press(other, false);
    render();
  });
}
for (const button of document.querySelectorAll("[data-layer]")) {
  const apply = () => {
    const on = button.getAttribute("aria-pressed") === "true";
    find("stage").classList.toggle(`without-${button.dataset.layer}`, !on);
    if (button.dataset.layer === "corners") video.look({ corners: on });
  };
  apply();
  button.addEventListener("click", () => {
    press(button, button.getAttribute("aria-pressed") !== "true");
    apply();
  });
}

document.addEventListener(
  "keydown",
  (event) => {
    if (event.key === "Escape") {
      event.preventDefault();
      if (!event.repeat) stop();
      return;
    }
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    if (event.target.closest("input, select, textarea")) return;
    if (event.key === "l" && state && !state.lease.holder) find("lease-take").click();
    if (event.key === "[") document.querySelector('[data-act="turn"][data-sign="1"]').click();
    if (event.key === "]") document.querySelector('[data-act="turn"][data-sign="-1"]').click();
  },
  true,
);

// --- what is shown -------------------------------------------------------------------------------------------------

/** Change a text only when it differs: screen readers speak of every change. */
function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function press(button, on) {
  button.setAttribute("aria-pressed", String(on));
}

/** The last command's result stands beside the buttons that gave it. */
function showLast(entry) {
  const element = find("last");
  element.hidden = false;
  element.dataset.status = entry.status;
  element.firstElementChild.textContent = ICONS[entry.status] ?? "";
  element.lastElementChild.textContent = spoken(entry);
}

function say(text, urgent = false) {
  find(urgent ? "say-now" : "say").textContent = text;
}

function isMine() {
  return Boolean(state && me.id && state.lease.holder === me.id && !link.silent);
}

function whyNot() {
  if (link.silent) return t("link_down");
  if (!isMine()) return t("no_lease");
  const age = video.ageMs;
  if (!(age <= limits.max_age_ms)) {
    return t("picture_late", { age_ms: Number.isFinite(age) ? Math.round(age) : "?", limit_ms: limits.max_age_ms });
  }
  if (state.refusal) return t(state.refusal.code, explained(state.refusal.values));
  return "";
}

function actionsAllowed(gesture) {
  return Boolean(selection?.gestures.includes(gesture)) && whyNot() === "";
}

function render() {
  if (!state) return;
  stateChip("chip-driver", state.driver);
  stateChip("chip-controller", state.controller);
  stateChip("chip-calibration", state.calibration);
  const seen = state.confidence > 0;
  const unsure = ["panel_not_seen", "low_confidence", "recognition_silent"].includes(state.refusal?.code);
  chip(
    "chip-recognition",
    unsure || !seen ? "waiting" : "good",
    seen ? t("recognised", { percent: Math.round(100 * state.confidence) }) : t("not_recognised"),
  );
  find("stage").classList.toggle("unsure", unsure || !seen);
  find("stage").classList.toggle("moving", state.moving);
  put(find("you"), t("you", { name: me.name, count: state.viewers }));
  ["x", "y", "stylus"].forEach((axis, index) => {
    const value = state.position_mm?.[index];
    put(find(`position-${axis}`), value === undefined ? "–" : t("mm", { value: value.toFixed(1) }));
  });
  renderLease();
  renderSelection();
  renderMachine();
  renderAge();
}

function renderLease() {
  const { holder, holder_name: name, requester, requester_name: asking } = state.lease;
  const mine = isMine();
  const asked = mine && requester;
  let text = mine ? t("lease_mine") : holder ? t("lease_other", { name }) : t("lease_free");
  if (asked) text = t("lease_asked", { name: asking });
  if (requester === me.id && me.id) text = t("lease_waiting", { name });
  put(find("lease-text"), text);
  find("lease-card").dataset.look = mine ? "mine" : "";
  find("lease-take").hidden = Boolean(holder);
  find("lease-request").hidden = !holder || mine || requester === me.id;
  find("lease-release").hidden = !mine;
  find("lease-grant").hidden = find("lease-decline").hidden = !asked;
}

function renderSelection() {
  const reason = whyNot();
  find("selection-card").dataset.look = selection ? "chosen" : "";
  put(find("selection-name"), selection
    ? selection.label || t("selection_point")
    : t("selection_none"));
  const [x, y] = selection?.panel_mm ?? [];
  put(find("selection-detail"), selection
    ? t("selection_detail", { kind: t(`kind_${selection.kind}`), x: x?.toFixed(1), y: y?.toFixed(1) })
    : t("selection_hint"));
  for (const button of document.querySelectorAll("[data-act]")) {
    const able = selection ? selection.gestures.includes(button.dataset.act) : button.dataset.act === "press";
    (button.closest("[data-for]") ?? button).hidden = !able;
    button.disabled = !selection || !able || reason !== "";
  }
  find("clear").hidden = !selection;
  find("clear").disabled = !isMine();
  const text = problem || (selection || !isMine() ? reason : "");
  const element = find("refusal");
  put(element, text);
  element.dataset.look = problem ? "bad" : "";
}

function renderMachine() {
  const mine = isMine();
  const stopped = state.driver.state === "stopped" || state.driver.state === "alarm";
  for (const button of document.querySelectorAll("[data-call]")) {
    button.disabled = !mine || (button.dataset.call !== "disable" && state.moving);
    if (button.dataset.call === "reset") button.classList.toggle("primary", stopped);
  }
  put(find("calibration-text"), state.calibration.reason
    ? `${t("chip_calibration")}: ${t(`state_${state.calibration.state}`, state.calibration)}${
        state.calibration.state === "calibrating" ? "" : ` – ${state.calibration.reason}`
      }`
    : "");
}

function renderAge() {
  const age = video.ageMs;
  const stage = find("stage");
  const stale = age > limits.stale_ms;
  stage.dataset.age = stale ? "stale" : age > limits.max_age_ms ? "old" : age > limits.amber_ms ? "late" : "live";
  const look = { stale: "bad", old: "bad", late: "waiting", live: "good" }[stage.dataset.age];
  chip("chip-video", look, Number.isFinite(age) ? t("live", { age: Math.round(age) }) : t("no_picture"));
  put(find("age"), Number.isFinite(age) && !stale ? t("live", { age: Math.round(age) }) : "");
  find("stale").hidden = !stale;
  if (stale) put(find("stale"), Number.isFinite(age) ? t("stale", { age: (age / 1000).toFixed(1) }) : t("no_picture"));
  const silent = link.silent;
  const rtt = link.rttMs === null ? "–" : Math.round(link.rttMs);
  chip("chip-link", silent ? "bad" : "good", silent ? t("link_lost") : t("link_ok", { rtt }));
  const { state: driver, reason } = state?.driver ?? {};
  banner(find("banner"), [
    { when: silent, look: "bad", text: t("banner_link") },
    { when: driver === "alarm", look: "bad", text: t("banner_alarm", { reason }) },
    {
      when: driver === "stopped",
      look: "bad",
      text: reason ? t("banner_stopped", { reason }) : t("banner_stopped_bare"),
    },
    { when: age > limits.max_age_ms, look: "waiting", text: t("banner_stale") },
    { when: restarted, look: "waiting", text: t("banner_restarted") },
    { when: lostControl, look: "waiting", text: t("banner_lost_control") },
    { when: !state, look: "none", text: t("banner_connecting") },
    { when: state?.moving, look: "busy", text: t("banner_moving") },
    { when: !isMine(), look: "none", text: t("banner_viewing") },
    { when: state?.refusal, look: "waiting", text: t("banner_waiting", { reason: whyNot() }) },
    { when: true, look: "good", text: t("banner_ready") },
  ]);
}

// --- the beat: keep-alives come from animation frames, so a hidden or frozen page stops the machine -------------------

let lastAlive = -Infinity;
let lastShown = -Infinity;
function beat(now) {
  if (now - lastAlive >= KEEP_ALIVE_MS - 8) {
    lastAlive = now;
    link.alive();
  }
  if (now - lastShown >= 100) {
    lastShown = now;
    link.watch();
    if (state) render();
    else renderAge();
  }
  requestAnimationFrame(beat);
}

if (location.search) history.replaceState(null, "", "/"); // the used token is no business of the address bar
link.connect();
video.connect();
requestAnimationFrame(beat);
