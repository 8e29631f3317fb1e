// Control connection: numbered messages, answers, round trip, and detection of a dead server (without a close event).

import { setClock } from "./clock.js";

const SILENT_MS = 1500;
const ANSWER_MS = 3000;
const LOOK_MS = 500; // maximum time counted between two checks
const CLOCK_MS = 20; // browsers round their clocks, and clocks differ in speed
const CLOCKS = 25; // answers of the last 5 s: the fastest gives the best estimate of the bridge's clock

export class Link extends EventTarget {
  #socket = null;
  #seq = 0;
  #boot = "";
  #waiting = new Map();
  #retryMs = 300;
  #lastHeard = 0;
  #heardAwakeMs = 0;
  #lastLook = performance.now();
  #clocks = []; // {rtt, ahead}: round trips, and lead of the bridge's clock over this page's
  epoch = 0;
  /** The bridge's id of this page, until the next connection. */
  page = "";
  rttMs = null;
  /** Time in which the page was running: after a delay it has not yet processed the messages that arrived meanwhile. */
  awakeMs = 0;
  #signedInUntil = null; // by this page's clock; null while far away

  /** Milliseconds until the sign-in ends, null while far away. */
  get signInEndsMs() {
    return this.#signedInUntil === null ? null : this.#signedInUntil - performance.now();
  }

  get open() {
    return this.#socket !== null && this.#boot !== "" && this.#socket.readyState === WebSocket.OPEN;
  }

  /** The number of the last message sent on this connection. */
  get sent() {
    return this.#seq;
  }

  get silent() {
    return !this.open || performance.now() - this.#lastHeard > SILENT_MS;
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/control`);
    this.#socket = socket;
    this.#boot = "";
    this.#clocks = [];
    this.#heard();
    socket.addEventListener("message", (event) => this.#take(JSON.parse(event.data)));
    socket.addEventListener("close", () => this.#lost(socket));
  }

  /** Transit time in ms of a message sent at `sent` by the bridge's clock and received at `arrived` by this page's. */
  way(sent, arrived) {
    if (!this.#clocks.length) return (this.rttMs ?? 0) / 2;
    return Math.max(0, arrived + this.#ahead - sent);
  }

  /** Current time of the bridge's clock; undefined while unknown. */
  get bridgeMs() {
    return this.#clocks.length ? performance.now() + this.#ahead : undefined;
  }

  get #ahead() {
    return this.#clocks.reduce((best, one) => (one.rtt < best.rtt ? one : best)).ahead;
  }

  /** Call often: gives up overdue answers, and a connection on which nothing arrives. */
  watch() {
    const now = performance.now();
    this.awakeMs += Math.min(now - this.#lastLook, LOOK_MS);
    this.#lastLook = now;
    for (const [seq, { untilAwakeMs }] of [...this.#waiting]) if (this.awakeMs > untilAwakeMs) this.#giveUp(seq);
    if (this.#socket && this.awakeMs - this.#heardAwakeMs > 2 * SILENT_MS) {
      const socket = this.#socket;
      socket.close();
      this.#lost(socket);
    }
  }

  /** Send and return the answer {ok, code, values}; never rejects. */
  ask(type, fields = {}) {
    if (!this.open) return Promise.resolve({ ok: false, code: "link_down", values: {} });
    const seq = this.#send(type, fields);
    return new Promise((resolve) => this.#waiting.set(seq, { resolve, untilAwakeMs: this.awakeMs + ANSWER_MS }));
  }

  alive() {
    if (this.open) this.#send("alive", { client_ms: performance.now() });
  }

  hide() {
    if (this.open) this.#send("hidden", {});
  }

  blind(silenceMs) {
    if (this.open) this.#send("blind", { silence_ms: silenceMs });
  }

  /** The page is being closed, not only hidden: closing the connection reports this at once. */
  leave() {
    this.#socket?.close();
  }

  #send(type, fields) {
    this.#seq += 1;
    this.#socket.send(JSON.stringify({ type, seq: this.#seq, boot: this.#boot, epoch: this.epoch, ...fields }));
    return this.#seq;
  }

  #heard() {
    this.#lastHeard = performance.now();
    this.#heardAwakeMs = this.awakeMs;
  }

  #take(message) {
    this.#heard();
    if (message.type === "alive") {
      const now = performance.now();
      const rtt = now - message.client_ms;
      this.#compared({ rtt, ahead: message.bridge_ms + rtt / 2 - now });
      setClock(message.wall_ms + rtt / 2);
      this.#signedInUntil = "sign_in_ends_s" in message ? now + 1e3 * message.sign_in_ends_s : null;
      this.rttMs = this.rttMs === null ? rtt : 0.8 * this.rttMs + 0.2 * rtt;
      return;
    }
    if (message.type === "hello") {
      this.#boot = message.boot;
      this.page = message.you.id;
      this.#seq = 0;
      this.#retryMs = 300;
    }
    const state = message.type === "hello" ? message.state : message;
    if (state.lease) this.epoch = state.lease.epoch;
    if (message.type === "answer" && this.#settle(message)) return;
    this.dispatchEvent(new CustomEvent(message.type, { detail: message }));
  }

  /** Each answer gives the clocks' difference to half a round trip; one that does not fit shows that a clock was
  suspended. */
  #compared(clock) {
    const fits = (one) => Math.abs(one.ahead - clock.ahead) <= (one.rtt + clock.rtt) / 2 + CLOCK_MS;
    this.#clocks = [...(this.#clocks.every(fits) ? this.#clocks : []), clock].slice(-CLOCKS);
  }

  #settle(answer) {
    const waiting = this.#waiting.get(answer.seq);
    if (!waiting) return false;
    this.#waiting.delete(answer.seq);
    waiting.resolve(answer);
    return true;
  }

  #giveUp(seq) {
    this.#settle({ seq, ok: false, code: "link_down", values: {} });
  }

  async #lost(socket) {
    if (socket !== this.#socket) return;
    this.#socket = null;
    this.#boot = "";
    for (const seq of [...this.#waiting.keys()]) this.#giveUp(seq);
    this.dispatchEvent(new CustomEvent("lost"));
    await new Promise((resolve) => setTimeout(resolve, this.#retryMs));
    this.#retryMs = Math.min(2 * this.#retryMs, 5000);
    try {
      const answer = await fetch("/session", { signal: AbortSignal.timeout(3000) });
      if (answer.status === 401) {
        location.replace("/");
        return;
      }
    } catch {
      // the server is unavailable; the attempt below fails too and leads back here
    }
    this.connect();
  }
}
