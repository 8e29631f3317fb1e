// Teaching a new panel, for engineers: mark four corners and the controls in a held picture, write a layout.

import { desk } from "../connection/desk.js";
import { doubled, find, put, say } from "../elements/dom.js";
import { numberOf, putNumber } from "../elements/number_fields.js";
import { said } from "../language/said.js";
import { t } from "../language/strings.js";
import { wasDragged } from "../picture/tools.js";

const CORNERS = ["lower_left", "lower_right", "upper_right", "upper_left"];
let held = null; // {stamp, width, height}
let newest = ""; // stamp of the last requested picture
let corners = CORNERS.map(() => null); // [u, v], or null until marked
let controls = []; // {name, kind, size: [w, h], proud, at}
let active = 0; // index of the point that the next click sets: 0 to 3 the corners, then the controls
let answer = ""; // result of the last lesson in words
let command = "";

const place = (index) => (index < 4 ? corners[index] : controls[index - 4]?.at ?? null);
const all = () => [...Array(4 + controls.length).keys()];
const firstOpen = () => all().find((index) => place(index) === null);

function setPlace(index, at) {
  if (index < 4) corners[index] = at;
  else if (controls[index - 4]) controls[index - 4].at = at;
}

function name(index) {
  return index < 4 ? t(`corner_${CORNERS[index]}`) : controls[index - 4].name;
}

/** The held picture; null if it does not arrive or is no longer held. */
async function loaded(stamp) {
  try {
    const picture = await fetch(`/held.jpg?stamp=${stamp}`);
    return picture.ok ? await createImageBitmap(await picture.blob()) : null;
  } catch {
    return null;
  }
}

export async function setHeld(message) {
  newest = message.stamp;
  if (!message.stamp) {
    answer = t("no_picture");
    return;
  }
  const bitmap = await loaded(message.stamp);
  if (newest !== message.stamp) return; // another picture was held meanwhile
  if (!bitmap) {
    answer = t("teach_no_picture");
    return;
  }
  const canvas = find("held");
  canvas.width = message.width;
  canvas.height = message.height;
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  find("held-marks").setAttribute("viewBox", `-0.5 -0.5 ${message.width} ${message.height}`);
  held = message;
  answer = command = "";
  renderPlaces();
  show();
}

/** The held picture covers the live one while its tab is open; this page cannot move anything meanwhile. */
export function show() {
  const on = held !== null && !find("panel-teach").hidden;
  const changed = find("stage").classList.contains("teaching") !== on;
  find("stage").classList.toggle("teaching", on);
  find("held").hidden = !on;
  if (!changed) return;
  desk.teaching = on;
  desk.changed();
}

export function taught(message) {
  answer = message.ok ? t("teach_done", message) : t("teach_refused", { ...message, reason: said(message.reason) });
  command = message.ok ? message.start : "";
  say(answer, !message.ok);
}

function pointed(event) {
  if (!find("stage").classList.contains("teaching")) return;
  event.stopImmediatePropagation(); // a held picture has no selection
  if (wasDragged()) return;
  const area = find("held").getBoundingClientRect();
  const at = [
    Math.round(10 * (((event.clientX - area.left) / area.width) * held.width - 0.5)) / 10,
    Math.round(10 * (((event.clientY - area.top) / area.height) * held.height - 0.5)) / 10,
  ];
  setPlace(active, at);
  const open = firstOpen();
  active = open ?? active;
  renderPlaces();
}

function mark(index) {
  const at = place(index);
  if (!at) return [];
  const [u, v] = at;
  return doubled(`M${u - 12} ${v}h8M${u + 4} ${v}h8M${u} ${v - 12}v8M${u} ${v + 4}v8`, index === active ? "active" : "");
}

function outline() {
  if (corners.some((corner) => corner === null)) return [];
  return doubled(`M${corners.map((corner) => corner.join(" ")).join("L")}Z`);
}

function row(index) {
  const line = document.createElement("li");
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = name(index);
  button.setAttribute("aria-pressed", String(index === active));
  button.addEventListener("click", () => {
    active = index;
    renderPlaces();
  });
  const fields = ["u", "v"].map((axis, part) => {
    const field = document.createElement("input");
    field.inputMode = "decimal";
    Object.assign(field.dataset, { step: 0.5, min: 0, max: 10000 });
    field.setAttribute("aria-label", t("teach_place", { name: name(index), axis }));
    putNumber(field, place(index)?.[part] ?? NaN);
    field.addEventListener("change", () => {
      const values = fields.map(numberOf);
      setPlace(index, values.every(Number.isFinite) ? values : null);
      drawMarks();
    });
    return field;
  });
  line.append(button, ...fields);
  if (index >= 4) {
    const remove = document.createElement("button");
    remove.type = "button";
    remove.textContent = "✕";
    remove.setAttribute("aria-label", t("teach_remove", { name: name(index) }));
    remove.addEventListener("click", () => {
      controls.splice(index - 4, 1);
      active = Math.min(active, 3 + controls.length);
      renderPlaces();
    });
    line.append(remove);
  }
  return line;
}

function drawMarks() {
  find("held-marks").replaceChildren(...outline(), ...all().flatMap(mark));
}

function renderPlaces() {
  find("teach-corners").replaceChildren(...CORNERS.map((_, index) => row(index)));
  find("teach-controls").replaceChildren(...controls.map((_, index) => row(index + 4)));
  put(find("teach-next"), held ? t(place(active) ? "teach_all" : "teach_click", { name: name(active) }) : "");
  drawMarks();
}

function added(event) {
  event.preventDefault();
  const value = (id) => numberOf(find(`teach-${id}`));
  const kind = find("teach-kind").value;
  controls.push({ name: find("teach-name").value.trim(), kind, size: [value("w"), value("h")], proud: value("z"), at: null });
  find("teach-name").value = "";
  active = 3 + controls.length;
  renderPlaces();
  find("stage").scrollIntoView({ block: "nearest" }); // on a tablet the form is below the picture
}

async function write(event) {
  event.preventDefault();
  answer = command = "";
  desk.changed();
  const open = firstOpen();
  if (open !== undefined) {
    active = open;
    renderPlaces();
    answer = t("teach_click", { name: name(open) });
    return;
  }
  const good = await desk.ask("teach", {
    stamp: held.stamp,
    model: find("teach-model").value.trim(),
    title: find("teach-title").value.trim(),
    size_mm: ["teach-width", "teach-height"].map((id) => numberOf(find(id))),
    corners,
    controls: controls.map(({ name: called, kind, size, proud, at }) => [called, kind, ...at, ...size, proud]),
  });
  answer = good ? t("teach_working") : desk.problem;
}

export function wireTeach() {
  find("teach-hold").addEventListener("click", () => desk.ask("hold"));
  find("teach-add").addEventListener("submit", added);
  find("teach-form").addEventListener("submit", write);
  find("stage").addEventListener("click", pointed, true);
  renderPlaces();
}

/** Rewrite all names in another language. */
export const relabelTeach = renderPlaces;

export function renderTeach() {
  show();
  const why = desk.mine ? (desk.state.moving ? t("busy_moving") : "") : t("no_lease");
  find("teach-hold").disabled = why !== "";
  find("teach-write").disabled = why !== "" || !held;
  put(find("teach-said"), answer || why);
  put(find("teach-command"), command);
  find("teach-command").hidden = !command;
}
