// Cause of a stop in the page's language.

import { said } from "../language/said.js";
import { t } from "../language/strings.js";

/** Return the sentence for a stopped driver. */
export function stopBanner(state) {
  const reason = causeText(state);
  return reason ? t("banner_stopped", { reason }) : t("banner_stopped_bare");
}

function causeText({ stop_cause: cause, driver: { reason } }) {
  if (cause) {
    const after = cause.silence_s ? t("stopped_after", { seconds: cause.silence_s.toFixed(1) }) : "";
    return `${t(cause.code, { who: said(cause.who) })} ${after}`.trim();
  }
  return said(reason);
}
