// The control connection: numbered messages, answers, round trip, and noticing a dead server (no close event comes then).

import { setClock } from "./clock.js";

const SILENT_MS = 1500;
const ANSWER_MS = 3000;
const LOOK_MS = 500; // at most so much passes from one look to the next
const CLOCK_MS = 20; // browsers round their clocks, and clocks differ in speed
const CLOCKS = 25; // answers of the last 5 s: the quickest tells best what the bridge's clock shows

export class Link extends EventTarget {
  #socket = null;
  #seq = 0;
  #boot = "";
  #waiting = new Map();
  #retryMs = 300;
  #lastHeard = 0;
  #heardAwakeMs = 0;
  #lastLook = performance.now();
  #clocks = []; // {rtt, ahead}: round trips, and by how much the bridge's clock is ahead of this page's
  epoch = 0;
  /** Under which name the bridge knows this page, until it gets another one. */
  page = "";
  rttMs = null;
  /** Time in which the page could look: one that was held up has not yet seen what came meanwhile. */
  awakeMs = 0;
  #signedInUntil = null; // by this page's clock; null while the end is far

  /** In how many ms the sign-in ends, null while there is no hurry. */
  get signInEndsMs() {
    return this.#signedInUntil === null ? null : this.#signedInUntil - performance.now();
  }

  get open() {
    return this.#socket !== null && this.#boot !== "" && this.#socket.readyState === WebSocket.OPEN;
  }

  /** The number of the last message that was sent as this page. */
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

  /** How long something was on its way that was sent at `sent` by the bridge's clock and came at `arrived` by ours, ms. */
  way(sent, arrived) {
    if (!this.#clocks.length) return (this.rttMs ?? 0) / 2;
    return Math.max(0, arrived + this.#ahead - sent);
  }

  /** What the bridge's clock shows now; undefined while that is not known. */
  get bridgeMs() {
    return this.#clocks.length ? performance.now() + this.#ahead : undefined;
  }

  get #ahead() {
    return this.#clocks.reduce((best, one) => (one.rtt < best.rtt ? one : best)).ahead;
  }

  /** Call often: gives up answers that do not come, and a connection on which nothing arrives any more. */
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

  /** The page goes away, and is not only hidden: the closed connection says so at once. */
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

  /** An answer tells the difference of the clocks to half a round trip: one that does not fit shows that one stood still. */
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
      // the server is away; the connection attempt below fails too and we come back here
    }
    this.connect();
  }
}
