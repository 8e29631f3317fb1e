// Actions of people at the desk: stop, control, select, confirm, services; by pointer and by key.

import { openList, wireChoices } from "../elements/choices.js";
import { desk } from "../connection/desk.js";
import { answers, find, say } from "../elements/dom.js";
import { act, wireGestures } from "./gestures.js";
import { singleKey, wireSingleKeys } from "../elements/keys.js";
import { t } from "../language/strings.js";

const ARMED_MS = 4000;
const STOP_ANSWER_MS = 1000;
const CLICK_FOLLOWS_MS = 500; // maximum time from lifting a finger to its click

export function stop() {
  // Two paths at once: the open connection, and a plain request that needs only the sign-in. By `press` the bridge
  // recognises that both are one stop.
  const press = Math.random().toString(36).slice(2);
  let through = false;
  desk.stopping = true;
  const arrived = ({ ok }) => {
    if (!ok) return;
    through = true;
    desk.unstopped = false;
  };
  desk.link.ask("stop", { press }).then(arrived);
  // The request may overtake earlier messages on the connection; the bridge then refuses those.
  const { page, sent } = desk.link;
  fetch(`/stop?press=${press}&page=${page}&sent=${sent}`, { method: "POST", keepalive: true }).then(arrived, () => {});
  // Neither is given up, because on a hanging link it may still arrive. But the person must see that it has not.
  setTimeout(() => {
    if (through && !desk.unheard) return;
    desk.unstopped = true;
    say(t("banner_stop_failed"), true);
  }, STOP_ANSWER_MS);
}

export async function choose({ byKey, ...what }) {
  const at = document.activeElement;
  const good = await desk.select(what);
  // If the focus has moved meanwhile, the person is typing elsewhere and must not confirm anything.
  if (!good || !byKey || document.activeElement !== at) return;
  const able = [...find("confirm").querySelectorAll("button:not([disabled])")];
  able.find((button) => button.offsetParent !== null)?.focus();
}

function wireStop() {
  find("stop-form").addEventListener("submit", (event) => {
    event.preventDefault();
    stop();
  });
  // On press, not on release: a finger that slides off has still requested a stop. The click that follows is the same
  // press. A click without a pointer, as some screen readers send, is a separate press and counts as a mouse's.
  let [pointer, timer] = [null, 0];
  find("stop").addEventListener("pointerdown", ({ pointerId }) => {
    clearTimeout(timer);
    pointer = pointerId;
    stop();
  });
  for (const end of ["pointerup", "pointercancel"]) {
    document.addEventListener(end, ({ pointerId }) => {
      if (pointerId === pointer) timer = setTimeout(() => (pointer = null), CLICK_FOLLOWS_MS);
    });
  }
  find("stop").addEventListener("click", (event) => {
    if (event.detail === 0) return; // by key
    if (pointer !== null) event.preventDefault();
    pointer = null;
  });
}

function wireSelection() {
  find("clear").addEventListener("click", () => desk.select({}));
  find("chooser").addEventListener("change", async ({ target: chooser }) => {
    if (chooser.value) await choose({ control: chooser.value, byKey: false });
    chooser.value = desk.selection?.control ?? ""; // a refused control can be chosen again
  });
}

/** Services; those that take long and move far require a second click. */
function wireCalls() {
  for (const button of document.querySelectorAll("[data-call]")) {
    const service = button.dataset.call;
    let [timer, armedAt] = [0, 0];
    const name = (what) => {
      button.dataset.text = `${what}_${service}`; // changes with the language
      button.textContent = t(button.dataset.text);
    };
    const disarm = () => {
      clearTimeout(timer);
      delete button.dataset.armed;
      name("call");
    };
    button.addEventListener("click", (event) => {
      if ("armed" in button.dataset && !answers(event, armedAt)) return;
      if ("twice" in button.dataset && !("armed" in button.dataset)) {
        button.dataset.armed = "";
        armedAt = performance.now();
        name("confirm");
        timer = setTimeout(disarm, ARMED_MS);
        return;
      }
      disarm();
      desk.ask("call", { service, sent_ms: desk.link.bridgeMs });
    });
  }
}

function wireKeys() {
  const keys = {
    l: () => desk.state && !desk.state.lease.holder && find("lease-take").click(),
    "[": () => act(document.querySelector('[data-act="turn"][data-sign="1"]')),
    "]": () => act(document.querySelector('[data-act="turn"][data-sign="-1"]')),
    "<": () => act(document.querySelector('[data-act="click"][data-sign="-1"]')),
    ">": () => act(document.querySelector('[data-act="click"][data-sign="1"]')),
    d: () => find("draw").offsetParent && find("draw").click(),
    "?": openHelp,
  };
  let escaped = false; // Esc is held, and has stopped
  document.addEventListener(
    "keydown",
    (event) => {
      if (event.key === "Escape") {
        escaped = true;
        if (!openList()) event.preventDefault(); // Esc must also close the open list
        if (!event.repeat) stop();
        closeHelp();
        return;
      }
      // A held key is one press: its repeats must not confirm the control it has just selected.
      if (event.repeat && event.key === "Enter" && event.target.closest("button")) event.preventDefault();
      if (!event.repeat && !find("help").open) keys[singleKey(event)]?.();
    },
    true,
  );
  // A list drawn by the browser, such as autocompletion, consumes the key's press; only its release arrives here.
  document.addEventListener(
    "keyup",
    (event) => {
      if (event.key !== "Escape") return;
      if (!escaped && event.target.closest?.("select, input, textarea")) stop();
      escaped = false;
    },
    true,
  );
  window.addEventListener("blur", () => (escaped = false)); // the key is released elsewhere
  find("help-open").addEventListener("click", openHelp);
  find("help-close").addEventListener("click", closeHelp);
  find("help").addEventListener("close", () => shut(false));
  find("help").addEventListener("focusout", ({ relatedTarget: next }) => {
    if (next && !find("help").contains(next)) find("help").close();
  });
}

/** A wheel over a number field scrolls the page instead of changing the typed number. */
function wireNumbers() {
  const letGo = ({ target }) => target.type === "number" && target.blur();
  document.addEventListener("wheel", letGo, { capture: true, passive: true });
}

function shut(on) {
  document.querySelector("main").inert = on;
}

/** Not modal, and below the head: while it is open, STOP can be pressed, and nothing else. */
function openHelp() {
  const help = find("help");
  const bottoms = [document.querySelector(".top"), find("banner")].map((part) => part.getBoundingClientRect().bottom);
  help.style.setProperty("--top", `${Math.max(...bottoms)}px`);
  help.show();
  shut(true);
}

/** An inert page takes no focus, so it is enabled before the browser restores the focus. */
function closeHelp() {
  shut(false);
  find("help").close();
}

export function wireActions() {
  wireStop();
  wireSelection();
  wireGestures();
  for (const step of ["take", "request", "release"]) {
    find(`lease-${step}`).addEventListener("click", () => desk.ask("lease", { step }));
  }
  find("lease-withdraw").addEventListener("click", () => desk.ask("lease", { step: "release" })); // the request only
  for (const step of ["grant", "decline"]) {
    // The request whose name is shown: another one may have arrived since.
    find(`lease-${step}`).addEventListener("click", () => desk.ask("lease", { step, to: find("lease-text").dataset.asking }));
  }
  wireCalls();
  wireNumbers();
  wireChoices();
  wireSingleKeys();
  wireKeys();
}
