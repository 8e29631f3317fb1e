// The live picture: newest frame only. A frame is acknowledged once it is drawn, so a slow or hidden page gets fewer.

export const COMPUTED = ["corners", "edges"]; // layers that are found in each picture, only while somebody looks
const SILENT_MS = 1000;
const PATIENCE_MS = [3000, 24_000]; // at first, and at most: on a very slow link a picture may be long on its way

export class Video extends EventTarget {
  #socket = null;
  #canvas;
  #context;
  #wish = { camera: "left", corners: false, edges: false };
  #retryMs = 300;
  #retry = 0;
  #heard = 0;
  #waitsAwakeMs = 0; // since when a picture is waited for, in the link's time in which the page could look
  #patienceMs = PATIENCE_MS[0];
  #pending = null; // {about, jpeg, arrived, socket}
  #decoding = false;
  #passedOver = null; // what was said with the last picture that brought outlines and was not shown
  #link;
  shown = null; // {camera, stamp, age_ms, sent_ms, light, arrived}; age_ms: when it was sent, by the bridge's clock

  constructor(canvas, link) {
    super();
    this.#canvas = canvas;
    this.#context = canvas.getContext("2d", { alpha: false });
    this.#link = link;
  }

  factor = 1; // simulated over wall time; 1 where nothing is simulated

  /** Age of the shown picture in ms, by the graph's time: age when sent, its way, and the time since it came. */
  get ageMs() {
    if (!this.shown) return Infinity;
    const { age_ms, sent_ms, arrived } = this.shown;
    return age_ms + (this.#link.way(sent_ms, arrived) + performance.now() - arrived) * this.factor;
  }

  /** How long nothing new has been seen: the picture's age; before the first one of a camera, since any other came. */
  get blindMs() {
    return this.shown ? this.ageMs : performance.now() - this.#heard;
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    clearTimeout(this.#retry);
    const socket = new WebSocket(`${scheme}://${location.host}/video`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#waitsAwakeMs = this.#link.awakeMs;
    socket.addEventListener("open", () => {
      this.#retryMs = 300;
      this.#send(this.#wish);
    });
    socket.addEventListener("message", (event) => {
      if (typeof event.data === "string" || socket !== this.#socket) return;
      this.#heard = performance.now();
      this.#waitsAwakeMs = this.#link.awakeMs;
      this.#patienceMs = PATIENCE_MS[0];
      if (this.#pending) this.#passOver(this.#pending.about);
      this.#pending = { ...parts(event.data), arrived: performance.now(), socket };
      this.#decode();
    });
    socket.addEventListener("close", () => {
      if (socket !== this.#socket) return;
      this.#retry = setTimeout(() => this.connect(), this.#retryMs);
      this.#retryMs = Math.min(2 * this.#retryMs, 5000);
    });
  }

  /** Ask anew where nothing has come for a while: no close event may ever come of a connection that hangs. */
  renew() {
    if (performance.now() - this.#heard < SILENT_MS) return;
    const before = this.#socket;
    this.connect();
    before?.close();
  }

  /** Call often: a connection may hang alone, while the other one lives. */
  watch() {
    if (this.#link.awakeMs - this.#waitsAwakeMs < this.#patienceMs) return;
    this.#patienceMs = Math.min(2 * this.#patienceMs, PATIENCE_MS[1]);
    this.renew();
  }

  look(wish) {
    if (wish.camera !== undefined && wish.camera !== this.#wish.camera) this.shown = null;
    this.#wish = { ...this.#wish, ...wish };
    this.#send(this.#wish);
  }

  get camera() {
    return this.#wish.camera;
  }

  #send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }

  async #decode() {
    if (this.#decoding) return;
    this.#decoding = true;
    while (this.#pending) {
      const { about, jpeg, arrived, socket } = this.#pending;
      this.#pending = null;
      try {
        const bitmap = await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }));
        if (about.camera === this.#wish.camera) this.#show(about, bitmap, arrived);
        bitmap.close();
      } catch (error) {
        console.error("a picture could not be decoded", error);
        this.#passOver(about);
      }
      if (socket === this.#socket) await this.#drawn(about.seq);
    }
    this.#decoding = false;
  }

  /** The panel's outlines come once, until it moves: a picture that is not shown leaves them to the next one. */
  #passOver(about) {
    if (about.panel) this.#passedOver = about;
  }

  #show(about, bitmap, arrived) {
    const left = this.#passedOver;
    if (left?.camera === about.camera && left.seq < about.seq) {
      about.panel ??= left.panel;
      this.#passedOver = null;
    }
    if (this.#canvas.width !== about.width || this.#canvas.height !== about.height) {
      this.#canvas.width = about.width;
      this.#canvas.height = about.height;
    }
    this.#context.drawImage(bitmap, 0, 0, about.width, about.height); // light pictures are half as large
    // What was under way when a layer was switched off is not wanted any more.
    for (const layer of COMPUTED) if (!this.#wish[layer]) delete about[layer];
    const { camera, stamp, age_ms, sent_ms, light } = about;
    this.shown = { camera, stamp, age_ms, sent_ms, light, arrived };
    this.dispatchEvent(new CustomEvent("frame", { detail: about }));
  }

  /** Acknowledge in the next animation frame: hidden pages have none, and then the server makes no pictures for us. */
  #drawn(seq) {
    return new Promise((resolve) =>
      requestAnimationFrame(() => {
        this.#send({ drawn: seq });
        resolve();
      }),
    );
  }
}

/** Take a message apart: four bytes (the JSON's length), what is said of the picture, and the picture. */
function parts(data) {
  const length = new DataView(data).getUint32(0);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  return { about, jpeg: new Uint8Array(data, 4 + length) };
}
