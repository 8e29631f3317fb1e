// The layer over the picture: outlines and marks in SVG, and a real button for each control. Coordinates are raw pixels
// of the picture; the centre of the first pixel is (0, 0), hence the half pixel.

import { doubled, svg } from "../elements/dom.js";
import { t } from "../language/strings.js";

const ONE_LINE = 30; // letters of a name that certainly fit into one line
const ROOM = 1000; // px of the picture around a control without neighbours: larger than ever needed

export class Overlay extends EventTarget {
  #svg;
  #box;
  #stage;
  #layers = {};
  #buttons = new Map();
  #panel = { outline: [], controls: [], missing: "picture" };
  #selection = null;
  #size = [1280, 720];
  #seen;

  /** `seen` returns the seen state of a control in words. */
  constructor(stage, drawing, box, seen = () => "") {
    super();
    this.#seen = seen;
    this.#stage = stage;
    this.#svg = drawing;
    this.#box = box;
    const names = ["edges", "outline", "controls", "corners", "path", "target", "tip", "chosen", "line"];
    for (const name of names) {
      this.#layers[name] = svg("g", { class: `layer-${name}` });
      drawing.append(this.#layers[name]);
    }
    box.addEventListener("keydown", (event) => this.#arrows(event));
    stage.addEventListener("click", (event) => this.#clicked(event));
  }

  get controls() {
    return this.#panel.controls;
  }

  /** Missing part of the drawn panel, "picture", "camera" or "panel"; empty if none is missing. */
  get missing() {
    return this.#panel.missing;
  }

  frame(about) {
    if (about.width !== this.#size[0] || about.height !== this.#size[1] || !this.#svg.hasAttribute("viewBox")) {
      this.#size = [about.width, about.height];
      this.#svg.setAttribute("viewBox", `-0.5 -0.5 ${about.width} ${about.height}`);
      this.#stage.style.aspectRatio = `${about.width} / ${about.height}`;
      this.#placeAll();
    }
    if (about.panel) this.#show(about.panel);
    this.#mark("tip", about.tip);
    this.#mark("target", about.target);
    // A planned path of the tip is dashed.
    this.#draw("path", path(about.path, false), about.planned ? "planned" : "");
    // On a slow link only some pictures come with corners and edges.
    if (about.corners) this.#dots(about.corners);
    if (about.edges) this.#edges(about.edges);
  }

  /** Clear layers found in the picture: they were switched off, or the camera has changed. */
  forget(...names) {
    for (const name of names) this.#layers[name].replaceChildren();
  }

  select(selection) {
    this.#selection = selection;
    for (const [name, button] of this.#buttons) button.setAttribute("aria-pressed", String(selection?.control === name));
    this.#drawControls();
    this.#mark("chosen", selection && !selection.control && !selection.to_pixel ? selection.pixel : null);
    this.line(null);
  }

  /** Draw an arrow from one pixel to another; without one, the selected line. */
  line(ends) {
    const { pixel, to_pixel: to } = this.#selection ?? {};
    const [from, end] = ends ?? (to ? [pixel, to] : []);
    this.#draw("line", from ? arrow(from, end) : "");
  }

  /** Rename the buttons, in another language or after a change of the panel's state. */
  relabel() {
    for (const control of this.#panel.controls) this.#label(control);
  }

  #label(control) {
    const button = this.#buttons.get(control.name);
    const name = [control.label, t(`kind_${control.kind}`), this.#seen(control.name)].filter(Boolean).join(", ");
    if (button && button.getAttribute("aria-label") !== name) button.setAttribute("aria-label", name);
  }

  #show(panel) {
    const before = this.#panel.controls.map((control) => control.name).join();
    const missed = this.#panel.missing;
    this.#panel = panel;
    const names = panel.controls.map((control) => control.name);
    if (names.join() !== before) this.#makeButtons(panel.controls);
    this.#placeAll();
    this.#draw("outline", path(panel.outline, true));
    this.#drawControls();
    if (names.join() !== before || panel.missing !== missed) this.dispatchEvent(new CustomEvent("controls"));
  }

  #makeButtons(controls) {
    const inReadingOrder = [...controls].sort((a, b) => Math.round((a.box[1] - b.box[1]) / 24) || a.box[0] - b.box[0]);
    const focused = document.activeElement?.dataset?.control;
    this.#buttons.clear();
    this.#box.replaceChildren();
    for (const control of inReadingOrder) {
      const button = document.createElement("button");
      button.type = "button";
      button.dataset.control = control.name;
      button.dataset.kind = control.kind;
      button.dataset.tag = control.label;
      button.setAttribute("aria-pressed", String(this.#selection?.control === control.name));
      if (control.kind === "connector") button.setAttribute("aria-disabled", "true");
      this.#buttons.set(control.name, button);
      this.#label(control);
      this.#box.append(button);
      if (focused === control.name) button.focus();
    }
  }

  #placeAll() {
    const [width, height] = this.#size;
    const rooms = roomsOf(this.#panel.controls);
    for (const [number, control] of this.#panel.controls.entries()) {
      const style = this.#buttons.get(control.name)?.style;
      if (!style) continue;
      const [x, y, w, h] = control.box;
      style.left = `${(100 * (x + 0.5)) / width}%`;
      style.top = `${(100 * (y + 0.5)) / height}%`;
      style.width = `${(100 * w) / width}%`;
      style.height = `${(100 * h) / height}%`;
      style.setProperty("--w", `${(100 * w) / width}%`);
      style.setProperty("--h", `${(100 * h) / width}%`);
      style.setProperty("--room-x", `${(100 * rooms[number][0]) / width}%`);
      style.setProperty("--room-y", `${(100 * rooms[number][1]) / width}%`);
      this.#buttons.get(control.name).dataset.tagAt = tagPlace(control, this.#size);
      style.zIndex = String(Math.max(1, 1000 - Math.round(Math.sqrt(w * h)))); // small controls are on top
    }
  }

  #drawControls() {
    const shapes = this.#panel.controls.flatMap((control) => {
      const chosen = this.#selection?.control === control.name ? " chosen" : "";
      return doubled(path(control.outline, true), `${control.kind}${chosen}`);
    });
    this.#layers.controls.replaceChildren(...shapes);
  }

  #dots(corners) {
    let d = "";
    for (let i = 0; i + 1 < corners.length; i += 2) d += `M${corners[i]} ${corners[i + 1]}h0`;
    this.#draw("corners", d);
  }

  #edges(lines) {
    this.#draw("edges", lines.map(([u, v, ...rest]) => `M${u} ${v}L${rest.join(" ")}`).join(""));
  }

  /** Redraw a layer's line only if it has changed: in most pictures it has not. */
  #draw(name, d, look = "") {
    const layer = this.#layers[name];
    const shown = layer.lastChild;
    if (d ? shown?.getAttribute("d") === d && shown.getAttribute("class") === `over ${look}` : !shown) return;
    layer.replaceChildren(...(d ? doubled(d, look) : []));
  }

  #mark(name, pixel) {
    if (!pixel) {
      this.#draw(name, "");
      return;
    }
    const [u, v] = pixel;
    const r = name === "tip" ? 9 : 14;
    const d =
      `M${u - r} ${v}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0` +
      `M${u - 1.7 * r} ${v}h${r}M${u + 0.7 * r} ${v}h${r}M${u} ${v - 1.7 * r}v${r}M${u} ${v + 0.7 * r}v${r}`;
    this.#draw(name, d);
  }

  #clicked(event) {
    const button = event.target.closest("[data-control]");
    const byKey = event.detail === 0;
    // A touch screen is touched at the clicked point; by keyboard, at its centre.
    if (button && (byKey || button.dataset.kind !== "touch_area")) {
      this.dispatchEvent(new CustomEvent("choose", { detail: { control: button.dataset.control, byKey } }));
      return;
    }
    const [u, v] = this.pixel(event);
    this.dispatchEvent(new CustomEvent("choose", { detail: { u, v, byKey } }));
  }

  /** Pixel of the image under a pointer. */
  pixel(event) {
    const area = this.#svg.getBoundingClientRect();
    const u = ((event.clientX - area.left) / area.width) * this.#size[0] - 0.5;
    const v = ((event.clientY - area.top) / area.height) * this.#size[1] - 0.5;
    return [round(u), round(v)];
  }

  /** Arrow keys move the focus to the nearest control in that direction. */
  #arrows(event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const from = this.#panel.controls.find((control) => control.name === event.target.dataset?.control);
    if (!way || !from || event.shiftKey || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    const [x, y] = centre(from);
    let best = null;
    for (const control of this.#panel.controls) {
      const [dx, dy] = [centre(control)[0] - x, centre(control)[1] - y];
      const along = dx * way[0] + dy * way[1];
      const across = Math.abs(dx * way[1]) + Math.abs(dy * way[0]);
      if (along < 2 || across > 2 * along) continue;
      const cost = along + 2 * across;
      if (!best || cost < best.cost) best = { cost, name: control.name };
    }
    if (best) this.#buttons.get(best.name).focus();
  }
}

/** An arrow with a ring at its start and a head at its end. */
function arrow([u, v], [toU, toV]) {
  const length = Math.hypot(toU - u, toV - v) || 1;
  const [du, dv] = [(12 * (toU - u)) / length, (12 * (toV - v)) / length];
  const head = [[-du - dv / 2, -dv + du / 2], [-du + dv / 2, -dv - du / 2]].map(([a, b]) => `M${toU} ${toV}l${a} ${b}`);
  return `M${u - 6} ${v}a6 6 0 1 0 12 0a6 6 0 1 0 -12 0M${u} ${v}L${toU} ${toV}${head.join("")}`;
}

/** Distance around each control, in px of the picture, in which a click selects it: half way to other middles. */
function roomsOf(controls) {
  const rooms = controls.map(() => [ROOM, ROOM]);
  controls.forEach((one, a) => controls.slice(0, a).forEach((other, b) => {
    const apart = [0, 1].map((axis) => Math.abs(centre(one)[axis] - centre(other)[axis]));
    const gaps = apart.map((distance, axis) => distance - (one.box[axis + 2] + other.box[axis + 2]) / 2);
    const axis = gaps[0] > gaps[1] ? 0 : 1; // axis along which they are farther apart
    for (const [room, { box }] of [[rooms[a], one], [rooms[b], other]]) {
      room[axis] = Math.min(room[axis], Math.max(0, (apart[axis] - box[axis + 2]) / 2));
    }
  }));
  return rooms;
}

/** Position of a control's name: above its middle, unless the picture's edge would cut it off. */
function tagPlace({ label, box }, [width, height]) {
  const [x, y] = [(box[0] + box[2] / 2) / width, box[1] / height];
  const [side] = [x < 1 / 3 && "left", x > 2 / 3 && "right"].filter(Boolean);
  return [side, y < (label.length > ONE_LINE ? 1 / 2 : 1 / 10) && "below"].filter(Boolean).join(" ");
}

function centre(control) {
  const [x, y, w, h] = control.box;
  return [x + w / 2, y + h / 2];
}

function round(value) {
  return Math.round(value * 10) / 10;
}

function path(points, closed) {
  return points.length ? `M${points.map(([u, v]) => `${u} ${v}`).join("L")}${closed ? "Z" : ""}` : "";
}
