// Connects the parts of the page: messages from the bridge, and their display.

import { startBeat } from "./connection/beat.js";
import { desk } from "./connection/desk.js";
import { renderStay, wireStay } from "./connection/stay.js";
import { find, say } from "./elements/dom.js";
import { keepFocus } from "./elements/focus.js";
import { relabelNumbers, wireNumbers } from "./elements/number_fields.js";
import { wireTabs } from "./elements/tabs.js";
import { keepLanguage, nextLanguage, startLanguage, t } from "./language/strings.js";
import { wireActions } from "./orders/actions.js";
import { wireDraw } from "./orders/draw.js";
import { followControl, renderLease } from "./orders/lease.js";
import { renderMove, wireMove } from "./orders/move.js";
import { renderSelection, setSelection, showChoices, wireSelection } from "./orders/selection.js";
import { renderSequence, setSequence, setSequences, wireSequence } from "./orders/sequence.js";
import { relabelTeach, renderTeach, setHeld, taught, wireTeach } from "./orders/teach.js";
import { wireLooks } from "./picture/looks.js";
import { Overlay } from "./picture/overlay.js";
import { renderPanel, seenText, setPanel } from "./picture/panel_seen.js";
import { renderTools, wireTools } from "./picture/tools.js";
import { isAtRest, renderAge, setTurnedAway } from "./reports/banner.js";
import { CommandLog, spoken } from "./reports/command_log.js";
import { Console } from "./reports/console.js";
import { renderGuide, sampleGuide } from "./reports/guide.js";
import { relabelCounts, renderHeader, showFacts } from "./reports/header.js";
import { catchUp, relabelLast, showLast, UNDER_WAY } from "./reports/last_command.js";
import { addError, renderPlots, sample } from "./reports/plots.js";
import { records, renderRecordings, setRecordings } from "./reports/recordings.js";

const READ_MS = 1000;
startLanguage();
offerLanguage();
const { link, video } = desk;
const overlay = new Overlay(find("stage"), find("overlay"), find("controls"), seenText);
const log = new CommandLog(find("log"));
const lines = new Console(find("console-lines"));
let instrument = ""; // name of the instrument
let known = false; // the first message of the bridge has arrived
let labelled = false; // whether the controls' names include their seen state, which needs a link
desk.changed = render;

// --- messages from the bridge --------------------------------------------------------------------------------------

link.addEventListener("hello", ({ detail }) => {
  if (known) video.renew(); // if this connection was hanging, the video's hangs as well
  setTurnedAway("");
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
  if (!link.open) setTurnedAway(desk.problem); // refused before the connection was accepted
});
link.addEventListener("lost", () => {
  if (desk.state) desk.state.lease = { ...desk.state.lease, holder: "", holder_name: "" };
  render();
});
video.addEventListener("frame", ({ detail }) => {
  overlay.frame(detail);
  find("stage").classList.remove("empty");
});

function entitle() {
  document.title = instrument ? `${instrument} – ${t("product")}` : t("product");
}

function offerLanguage() {
  const { name, title } = nextLanguage();
  find("language").lang = name;
  find("language").textContent = title;
}

function setState(next) {
  followControl(next);
  desk.state = next;
  if (isAtRest(next.driver)) desk.stopping = false;
  render();
}

find("language").addEventListener("click", () => {
  keepLanguage(nextLanguage().name);
  offerLanguage();
  entitle();
  overlay.relabel();
  showChoices();
  log.relabel();
  relabelLast();
  relabelTeach();
  relabelNumbers();
  render();
});

// --- what is shown -------------------------------------------------------------------------------------------------

function render() {
  if (!desk.state) return;
  const focused = document.activeElement;
  renderHeader();
  renderLease();
  renderSelection();
  renderMachine();
  renderPanel(overlay.controls);
  if (labelled === link.silent) {
    overlay.relabel();
    relabelCounts();
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

function show() {
  if (desk.state) render();
  else renderAge();
}

function plot(now) {
  sample(now);
  sampleGuide();
  renderPlots(now);
}

wireSelection(overlay);
wireLooks(overlay);
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
startBeat(show, plot);
