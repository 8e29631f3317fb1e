// What people do at the desk: stop, control, select, confirm, services; by pointer and by key.

import { desk } from "./desk.js";
import { find, say } from "./dom.js";
import { wireGestures } from "./gestures.js";
import { t } from "./strings.js";

const ARMED_MS = 4000;

export function stop() {
  // Two ways at once: the open connection, and a plain request that needs nothing but the sign-in.
  // The bridge knows by the press that it is one stop.
  const press = Math.random().toString(36).slice(2);
  const way = desk.link.ask("stop", { press });
  const other = fetch(`/stop?press=${press}`, { method: "POST", keepalive: true }).then((answer) => answer.ok, () => false);
  Promise.all([way, other]).then(([first, second]) => {
    if (!first.ok && !second) say(t("link_down"), true);
  });
}

export async function choose({ byKey, ...what }) {
  const good = await desk.ask("select", { ...desk.seen, ...what });
  if (!good || !byKey) return;
  const able = [...find("confirm").querySelectorAll("button:not([disabled])")];
  able.find((button) => button.offsetParent !== null)?.focus();
}

function wireStop() {
  find("stop-form").addEventListener("submit", (event) => {
    event.preventDefault();
    stop();
  });
  // On press, not on release: a finger that slides off has still said stop.
  find("stop").addEventListener("pointerdown", stop);
  find("stop").addEventListener("click", (event) => {
    if (event.detail !== 0) event.preventDefault(); // pointerdown has done it; a key comes through submit
  });
}

function wireSelection() {
  find("clear").addEventListener("click", () => desk.ask("select", desk.seen));
  find("chooser").addEventListener("change", (event) => {
    if (event.target.value) choose({ control: event.target.value, byKey: false });
  });
}

/** Services; what takes long and moves far wants a second click. */
function wireCalls() {
  for (const button of document.querySelectorAll("[data-call]")) {
    const service = button.dataset.call;
    let timer = 0;
    const disarm = () => {
      clearTimeout(timer);
      delete button.dataset.armed;
      button.textContent = t(`call_${service}`);
    };
    button.addEventListener("click", () => {
      if ("twice" in button.dataset && !("armed" in button.dataset)) {
        button.dataset.armed = "";
        button.textContent = t(`confirm_${service}`);
        timer = setTimeout(disarm, ARMED_MS);
        return;
      }
      disarm();
      desk.ask("call", { service });
    });
  }
}

function wireKeys() {
  const keys = {
    l: () => desk.state && !desk.state.lease.holder && find("lease-take").click(),
    "[": () => document.querySelector('[data-act="turn"][data-sign="1"]').click(),
    "]": () => document.querySelector('[data-act="turn"][data-sign="-1"]').click(),
    "<": () => document.querySelector('[data-act="click"][data-sign="-1"]').click(),
    ">": () => document.querySelector('[data-act="click"][data-sign="1"]').click(),
    d: () => find("draw").offsetParent && find("draw").click(),
    "?": () => find("help").showModal(),
  };
  document.addEventListener(
    "keydown",
    (event) => {
      if (event.key === "Escape") {
        event.preventDefault();
        find("help").close();
        if (!event.repeat) stop();
        return;
      }
      if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
      if (event.target.closest("input, select, textarea")) return;
      keys[event.key]?.();
    },
    true,
  );
  find("help-open").addEventListener("click", () => find("help").showModal());
  find("help-close").addEventListener("click", () => find("help").close());
}

export function wireActions() {
  wireStop();
  wireSelection();
  wireGestures();
  for (const step of ["take", "request", "release", "grant", "decline"]) {
    find(`lease-${step}`).addEventListener("click", () => desk.ask("lease", { step }));
  }
  wireCalls();
  wireKeys();
}
