// Live picture: newest frame only. A frame is acknowledged when it is drawn, so a slow or hidden page gets fewer.

export const COMPUTED = ["corners", "edges"]; // layers computed from each picture while a page shows them
const SILENT_MS = 1000;
const PATIENCE_MS = [3000, 24_000]; // initial and maximum: on a very slow link a picture takes long

export class Video extends EventTarget {
  #socket = null;
  #canvas;
  #context;
  #wish = { camera: "left", corners: false, edges: false };
  #retryMs = 300;
  #retry = 0;
  #heard = 0;
  #waitsAwakeMs = 0; // start of the wait for a picture, in the link's awake time
  #patienceMs = PATIENCE_MS[0];
  #pending = null; // {about, jpeg, arrived, socket}
  #decoding = false;
  #passedOver = null; // data of the last picture with outlines that was not shown
  #link;
  shown = null; // {camera, stamp, age_ms, sent_ms, light, arrived}; age_ms: age when it was sent, by the bridge's clock

  constructor(canvas, link) {
    super();
    this.#canvas = canvas;
    this.#context = canvas.getContext("2d", { alpha: false });
    this.#link = link;
  }

  factor = 1; // simulated over wall time; 1 without simulation

  /** Age of the shown picture in ms of the graph's time: age when sent, transit time, and time since arrival. */
  get ageMs() {
    if (!this.shown) return Infinity;
    const { age_ms, sent_ms, arrived } = this.shown;
    return age_ms + (this.#link.way(sent_ms, arrived) + performance.now() - arrived) * this.factor;
  }

  /** Time without a new picture: the picture's age; before a camera's first one, time since any arrival. */
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

  /** Reconnect if nothing has arrived for a while: a hanging connection may never send a close event. */
  renew() {
    if (performance.now() - this.#heard < SILENT_MS) return;
    const before = this.#socket;
    this.connect();
    before?.close();
  }

  /** Call often: this connection may hang while the other one works. */
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

  /** The panel's outlines are sent once until it moves: a picture that is not shown passes them on to the next one. */
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
    this.#context.drawImage(bitmap, 0, 0, about.width, about.height); // light pictures are smaller
    // Discard layers that were in transit when they were switched off.
    for (const layer of COMPUTED) if (!this.#wish[layer]) delete about[layer];
    const { camera, stamp, age_ms, sent_ms, light } = about;
    this.shown = { camera, stamp, age_ms, sent_ms, light, arrived };
    this.dispatchEvent(new CustomEvent("frame", { detail: about }));
  }

  /** Acknowledge in the next animation frame: a hidden page has none, so the server encodes no pictures for it. */
  #drawn(seq) {
    return new Promise((resolve) =>
      requestAnimationFrame(() => {
        this.#send({ drawn: seq });
        resolve();
      }),
    );
  }
}

/** Split a message: four bytes (length of the JSON), JSON about the picture, and the picture. */
function parts(data) {
  const length = new DataView(data).getUint32(0);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  return { about, jpeg: new Uint8Array(data, 4 + length) };
}
