// The beat: keep-alives come from animation frames, so a hidden or frozen page stops the machine.

import { desk } from "./desk.js";

const KEEP_ALIVE_MS = 200;
const SHOW_MS = 100;
const PLOT_MS = 250;
let seen = false; // the current motion has been visible, at its start or since
let lastAlive = -Infinity;
let lastShown = -Infinity;
let lastPlotted = -Infinity;

/** Start the keep-alives; `show` draws ten times a second, `plot(now)` four times. */
export function startBeat(show, plot) {
  const beat = (now) => {
    if (now - lastAlive >= KEEP_ALIVE_MS - 8) {
      lastAlive = now;
      desk.link.alive();
    }
    if (now - lastShown >= SHOW_MS) {
      lastShown = now;
      desk.link.watch();
      desk.video.watch();
      watchMotion();
      show();
    }
    if (now - lastPlotted >= PLOT_MS) {
      lastPlotted = now;
      plot(now);
    }
    requestAnimationFrame(beat);
  };
  window.addEventListener("pagehide", () => desk.link.leave()); // before it is hidden
  // A hidden page has no animation frames; it reports that it is hidden, so that the stop's cause is known.
  document.addEventListener("visibilitychange", () => document.visibilityState === "hidden" && desk.link.hide());
  requestAnimationFrame(beat);
}

function watchMotion() {
  const moving = desk.mine && desk.state.moving;
  const blindMs = desk.video.blindMs;
  const blind = blindMs > desk.limits.stale_ms;
  // A motion that started without a picture needs none, such as homing.
  if (moving && blind && seen) desk.link.blind(blindMs);
  seen = moving && !blind;
}
