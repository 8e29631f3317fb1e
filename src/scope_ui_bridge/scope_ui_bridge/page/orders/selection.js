// The selection: its card, the list of controls, and the reason why nothing can be done with it.

import { desk } from "../connection/desk.js";
import { find, put, putSteady, reachable } from "../elements/dom.js";
import { t } from "../language/strings.js";
import { seenText } from "../picture/panel_seen.js";
import { choose } from "./actions.js";
import { renderDraw } from "./draw.js";
import { renderGestures } from "./gestures.js";

let overlay = null;

/** Show the selection on this overlay, and choose what is clicked there. */
export function wireSelection(shown) {
  overlay = shown;
  overlay.addEventListener("controls", showChoices);
  showChoices();
  overlay.addEventListener("choose", ({ detail }) => choose(detail));
}

export function showChoices() {
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

export function setSelection(next) {
  const isNew = next && next.number !== desk.selection?.number;
  desk.selection = next;
  overlay.select(next);
  find("chooser").value = next?.control ?? "";
  desk.changed();
  if (isNew) showCard();
}

/** Scroll a scrolling desk back to the selection: people must see what they confirm. */
function showCard() {
  const card = find("selection-card");
  const column = card.parentElement;
  const above = card.getBoundingClientRect().top - column.getBoundingClientRect().top;
  if (above < 0) column.scrollTop += above; // stays 0 for a column that does not scroll
}

export function renderSelection() {
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
