// Tools of the picture: zoom and pan, show an earlier picture over the live one, save the view.

import { timeText, wallNow } from "../connection/clock.js";
import { desk } from "../connection/desk.js";
import { fileTime, find, press, put, save } from "../elements/dom.js";
import { singleKey } from "../elements/keys.js";
import { t } from "../language/strings.js";

const MAX_ZOOM = 8;
const CLICK_PX = 6; // a pointer that moves less has clicked
const view = { zoom: 1, x: 0, y: 0 }; // x, y: shift as a fraction of the stage
const pointers = new Map();
let dragged = false;
let before = null; // {canvas, at}: the picture at the last confirmation, or when frozen

function apply() {
  const limit = view.zoom - 1;
  view.x = Math.min(0, Math.max(-limit, view.x));
  view.y = Math.min(0, Math.max(-limit, view.y));
  const world = find("world").style;
  world.transform = `translate(${100 * view.x}%, ${100 * view.y}%) scale(${view.zoom})`;
  find("stage").classList.toggle("zoomed", view.zoom > 1);
  find("zoom-fit").textContent = `${Math.round(100 * view.zoom)} %`;
}

/** Zoom about a point of the stage, given as fractions. */
function zoom(factor, fx = 0.5, fy = 0.5) {
  const next = Math.min(MAX_ZOOM, Math.max(1, view.zoom * factor));
  view.x = fx - ((fx - view.x) * next) / view.zoom;
  view.y = fy - ((fy - view.y) * next) / view.zoom;
  view.zoom = next;
  apply();
}

function fractions(event) {
  const area = find("stage").getBoundingClientRect();
  return [(event.clientX - area.left) / area.width, (event.clientY - area.top) / area.height];
}

function wireZoom() {
  const stage = find("stage");
  find("zoom-in").addEventListener("click", () => zoom(1.5));
  find("zoom-out").addEventListener("click", () => zoom(1 / 1.5));
  find("zoom-fit").addEventListener("click", () => zoom(0));
  stage.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 400), ...fractions(event));
    },
    { passive: false },
  );
  stage.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, { at: fractions(event), from: [event.clientX, event.clientY] });
    dragged = false;
  });
  stage.addEventListener("pointermove", (event) => moved(event));
  for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
    stage.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  // A drag is no click and must not select anything. A key's click (detail 0) is not part of a drag.
  stage.addEventListener("click", (event) => dragged && event.detail !== 0 && event.stopPropagation(), true);
  document.addEventListener("keydown", (event) => {
    ({ "+": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: () => zoom(0) })[singleKey(event)]?.();
  });
}

function moved(event) {
  const pointer = pointers.get(event.pointerId);
  if (!pointer) return;
  const far = Math.hypot(event.clientX - pointer.from[0], event.clientY - pointer.from[1]);
  if (far < CLICK_PX && !dragged) return;
  dragged = true;
  const now = fractions(event);
  const others = [...pointers].filter(([id]) => id !== event.pointerId);
  if (others.length === 1) {
    const [ox, oy] = others[0][1].at;
    const spread = (at) => Math.hypot(at[0] - ox, at[1] - oy);
    zoom(spread(now) / Math.max(spread(pointer.at), 0.01), (now[0] + ox) / 2, (now[1] + oy) / 2);
  } else if (others.length === 0) {
    view.x += now[0] - pointer.at[0];
    view.y += now[1] - pointer.at[1];
    apply();
  }
  pointer.at = now;
}

// --- before and now ------------------------------------------------------------------------------------------------

function keep() {
  if (!desk.video.shown) return;
  const canvas = document.createElement("canvas");
  const live = find("picture");
  canvas.width = live.width;
  canvas.height = live.height;
  canvas.getContext("2d").drawImage(live, 0, 0);
  before = { canvas, at: wallNow(), camera: desk.video.shown.camera };
}

function hold(on) {
  desk.frozen = on && before !== null;
  const held = find("before");
  held.hidden = find("wipe-row").hidden = !desk.frozen;
  press(find("freeze"), desk.frozen);
  if (desk.frozen) {
    held.width = before.canvas.width;
    held.height = before.canvas.height;
    held.getContext("2d").drawImage(before.canvas, 0, 0);
    wipe();
  }
  desk.changed();
}

/** Remove a kept picture. */
export function showLive() {
  if (desk.frozen) hold(false);
}

function wipe() {
  find("before").style.clipPath = `inset(0 ${100 - Number(find("wipe").value)}% 0 0)`;
}

function wireBefore() {
  document.addEventListener("acting", () => !desk.frozen && keep());
  find("freeze").addEventListener("click", () => {
    if (!desk.frozen) keep();
    find("wipe").value = "100";
    hold(!desk.frozen);
  });
  find("compare").addEventListener("click", () => {
    find("wipe").value = "50";
    hold(!desk.frozen);
  });
  find("wipe").addEventListener("input", wipe);
}

export function renderTools() {
  if (desk.frozen) put(find("before-time"), t("before_time", { time: timeText(before.at) }));
  find("compare").disabled = !before || (before.camera !== desk.video.camera && !desk.frozen);
  find("freeze").disabled = find("snapshot").disabled = !desk.video.shown;
}

// --- saving --------------------------------------------------------------------------------------------------------

/** Save the picture as shown, with a line of instrument, camera, time, age and user. */
function snapshot() {
  const source = desk.frozen ? find("before") : find("picture");
  const canvas = document.createElement("canvas");
  const line = 28;
  canvas.width = source.width;
  canvas.height = source.height + line;
  const context = canvas.getContext("2d");
  context.fillStyle = "#000";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(source, 0, 0);
  context.fillStyle = "#fff";
  context.font = "16px sans-serif";
  const at = desk.frozen ? before.at : wallNow();
  const age = desk.frozen ? "" : ` · ${Math.round(desk.video.ageMs)} ms`;
  const about = `${document.title} · ${desk.seen.camera} · ${at.toISOString()}${age} · ${desk.me.name}`;
  context.fillText(about, 8, source.height + line - 9);
  canvas.toBlob((blob) => save(`picture_${fileTime(at)}.png`, blob), "image/png");
}

/** Whether the pointer's last motion was a drag, which is no click. */
export function wasDragged() {
  return dragged;
}

export function wireTools() {
  wireZoom();
  wireBefore();
  find("snapshot").addEventListener("click", snapshot);
}
