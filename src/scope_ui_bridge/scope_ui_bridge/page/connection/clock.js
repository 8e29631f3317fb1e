// The bridge's clock, which the times in log and records come from; this computer's clock may differ.

let ahead = Date.now() - performance.now();

/** Set the current time of the bridge's clock, in ms. */
export function setClock(wallMs) {
  ahead = wallMs - performance.now();
}

export function wallNow() {
  return new Date(ahead + performance.now());
}

/** The time of day, with the date if it is not today: a bridge runs for many shifts. */
export function timeText(ms) {
  const at = new Date(ms);
  const { lang } = document.documentElement;
  const time = at.toLocaleTimeString(lang, { timeStyle: "medium", hourCycle: "h23" });
  if (at.toDateString() === wallNow().toDateString()) return time;
  const day = at.toLocaleDateString(lang, { day: "numeric", month: "short" });
  return `${day.replaceAll(" ", "\u00a0")} ${time}`;
}
