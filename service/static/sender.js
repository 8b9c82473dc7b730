// One stream of this page's own over the WebSocket; what comes back goes to the view.

import { streamAddress } from "./api.js";
import { subprotocols } from "./key.js";

const SUBPROTOCOL = "doa.v1";
const DONE = 1000;

export class Sender {
  #stopped = false;
  #ended = false;

  /** The session's id, once the service has told it. */
  session = null;

  /**
   * @param start the fields of the `start` message that differ between streams
   * @param view takes the messages
   * @param onReady is called once, when audio may be sent
   * @param onEnd is called once, when no more can be
   */
  constructor(start, view, { onReady, onEnd }) {
    this.view = view;
    this.onReady = onReady;
    this.onEnd = onEnd;
    this.socket = new WebSocket(streamAddress(), subprotocols(SUBPROTOCOL));
    this.socket.onopen = () => this.socket.send(JSON.stringify({ ...COMMON, ...start }));
    this.socket.onmessage = ({ data }) => this.#take(JSON.parse(data));
    this.socket.onclose = (event) => this.#closed(event);
  }

  /** Whether audio may be sent. */
  get open() {
    return !this.#stopped && this.socket.readyState === WebSocket.OPEN;
  }

  /** Bytes that the network has not taken yet. */
  get waiting() {
    return this.socket.bufferedAmount;
  }

  send(samples) {
    if (this.open) this.socket.send(samples);
  }

  /** Send no more audio; the last results and the summary follow. */
  stop() {
    if (this.#stopped) return;
    if (this.open) this.socket.send('{"type":"stop"}');
    else this.socket.close();
    this.#stopped = true;
  }

  /** Leave at once; the view belongs to another stream. */
  abandon() {
    this.#stopped = true;
    this.socket.onmessage = this.socket.onclose = null;
    this.socket.close(DONE);
  }

  #take(message) {
    this.view.receive(message);
    if (message.type === "error" || message.type === "summary") this.#ended = true;
    if (message.type !== "ready") return;
    this.session = message.session;
    this.onReady();
  }

  #closed({ code, reason }) {
    this.#stopped = true;
    if (!this.#ended && code !== DONE) {
      const detail = reason || `The connection closed with code ${code} and no reason.`;
      this.view.fail({ title: "The stream broke off", detail });
    }
    this.onEnd();
  }
}

const COMMON = {
  type: "start",
  overflow: "drop_oldest",
  noise: "none", // what is kept under a client's name was learnt from another recording
  output: { interval_ms: 100, include: ["spectrum"] },
};
