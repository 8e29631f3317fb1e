// The header: states of the parts, recognition, position, and who is signed in.

import { desk } from "../connection/desk.js";
import { find, put } from "../elements/dom.js";
import { chip, stateChip } from "../elements/status.js";
import { t } from "../language/strings.js";
import { showCounts } from "./console.js";
import { setFacts } from "./guide.js";

let counts = {}; // the driver's counters

export function showFacts({ facts }) {
  setFacts(facts);
  counts = facts.driver;
  showCounts(counts);
}

/** Show the driver's counters, or none while the link is lost. */
export function relabelCounts() {
  showCounts(desk.link.silent ? {} : counts);
}

/** Programs whose trajectories and heartbeats the driver accepts. */
function movedBy() {
  const { trajectories_from: program, heartbeats_from: operator } = counts ?? {};
  return program ? t("moved_by", { program, operator: operator || "–" }) : "";
}

export function renderHeader() {
  const { state, me, link } = desk;
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
}
