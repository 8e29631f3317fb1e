// The bridge's clock, which the log and the records have their times from: this computer's may show another time.

let ahead = Date.now() - performance.now();

/** Note what the bridge's clock shows now, in ms. */
export function setClock(wallMs) {
  ahead = wallMs - performance.now();
}

export function wallNow() {
  return new Date(ahead + performance.now());
}

/** The time of day; with its date where that is not today: a bridge runs for many shifts. */
export function timeText(ms) {
  const at = new Date(ms);
  const { lang } = document.documentElement;
  const time = at.toLocaleTimeString(lang, { timeStyle: "medium", hourCycle: "h23" });
  if (at.toDateString() === wallNow().toDateString()) return time;
  const day = at.toLocaleDateString(lang, { day: "numeric", month: "short" });
  return `${day.replaceAll(" ", "\u00a0")} ${time}`;
}
