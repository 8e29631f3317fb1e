// End of a sign-in: announced some minutes before; a new sign-in here extends it, so that control and page remain.

import { desk } from "./desk.js";
import { find, put, say } from "../elements/dom.js";
import { t } from "../language/strings.js";

let problem = ""; // why the last attempt was refused

export function renderStay() {
  const form = find("stay");
  const endsMs = desk.link.signInEndsMs;
  if (endsMs === null) {
    form.hidden = true;
    problem = "";
    return;
  }
  const minutes = Math.max(1, Math.ceil(endsMs / 60_000));
  const text = t(desk.mine ? "stay_mine" : "stay_watching", { minutes });
  put(find("stay-text"), text);
  put(find("stay-label"), t(desk.me.by_password ? "sign_in_password" : "sign_in_token_label"));
  find("stay-secret").autocomplete = desk.me.by_password ? "current-password" : "off";
  find("stay-secret").title = desk.me.by_password ? "" : t("sign_in_no_token");
  put(find("stay-problem"), problem && t(problem));
  if (form.hidden) say(text); // screen readers do not announce an element that was hidden
  form.hidden = false;
}

async function stay(event) {
  event.preventDefault();
  const secret = find("stay-secret");
  const body = new URLSearchParams({ secret: secret.value });
  try {
    const { ok, code } = await (await fetch("/renew", { method: "POST", body })).json();
    problem = ok ? "" : code;
    if (ok) say(t("stay_done"));
  } catch {
    problem = "link_down";
  }
  secret.value = "";
  renderStay();
}

export function wireStay() {
  find("stay").addEventListener("submit", stay);
}
