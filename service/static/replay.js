// A WAV file sent as a robot would send its microphones: at its own pace, over the WebSocket.

import { streamAddress } from "./api.js";
import { subprotocols } from "./key.js";

const SUBPROTOCOL = "doa.v1";
const STEP_MS = 60;
const MAX_BYTES = 64 * 1024; // of one message
const LATE = 1.0; // seconds; a page that slept longer goes on from where it is
const CLIENT = "web-page";
const DONE = 1000;

/** Why a file cannot be replayed, or null. */
export function whyNotReplayable(header) {
  if (header.kind !== "wav") {
    return "Replay needs a WAV file, so that every channel is sent as it is. Convert it, for example: ffmpeg -i recording.flac recording.wav";
  }
  if (!header.encoding || !header.end) {
    return "Replay needs WAV with samples of 16, 24 or 32 bits, or 32-bit floating point.";
  }
  return null;
}

export class Replay {
  #timer = 0;
  #sent = 0; // bytes
  #stopped = false;
  #ended = false;

  /** The session's id, once the service has told it. */
  session = null;

  /** `onEnd` is called once when the stream is over. */
  constructor(setup, view, onEnd) {
    this.file = setup.file;
    this.header = setup.header;
    this.view = view;
    this.onEnd = onEnd;
    view.begin(`Sending ${this.file.name}…`);
    this.socket = new WebSocket(streamAddress(), subprotocols(SUBPROTOCOL));
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.socket.send(JSON.stringify(startMessage(setup)));
    this.socket.onmessage = ({ data }) => this.#take(JSON.parse(data));
    this.socket.onclose = (event) => this.#closed(event);
  }

  /** Send no more audio; the last results and the summary follow. */
  stop() {
    if (this.#stopped) return;
    this.#stopped = true;
    clearTimeout(this.#timer);
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send('{"type":"stop"}');
    else this.socket.close();
  }

  /** Leave at once; the view belongs to another stream. */
  abandon() {
    this.#stopped = true;
    clearTimeout(this.#timer);
    this.socket.onmessage = this.socket.onclose = null;
    this.socket.close(DONE);
  }

  #take(message) {
    this.view.receive(message);
    if (message.type === "error" || message.type === "summary") this.#ended = true;
    if (message.type === "ready") {
      this.session = message.session;
      this.began = performance.now();
      this.view.say(`Replaying ${this.file.name}.`, "live");
      this.#send();
    }
  }

  async #send() {
    const { sampleRate, blockAlign, start, end } = this.header;
    const rate = sampleRate * blockAlign; // bytes per second
    const most = Math.floor(MAX_BYTES / blockAlign) * blockAlign;
    let due = ((performance.now() - this.began) / 1000) * rate;
    if (due - this.#sent > LATE * rate) {
      this.began = performance.now() - (this.#sent / rate) * 1000;
      due = this.#sent;
    }
    const goal = Math.min(end - start, Math.ceil(due / blockAlign) * blockAlign);
    while (this.#sent < goal) {
      const length = Math.min(most, goal - this.#sent);
      const from = start + this.#sent;
      this.#sent += length;
      const samples = await this.file.slice(from, from + length).arrayBuffer();
      if (this.#stopped || this.socket.readyState !== WebSocket.OPEN) return;
      this.socket.send(samples);
    }
    if (this.#sent >= end - start) this.stop();
    else this.#timer = setTimeout(() => this.#send(), STEP_MS);
  }

  #closed({ code, reason }) {
    clearTimeout(this.#timer);
    this.#stopped = true;
    if (!this.#ended && code !== DONE) {
      const detail = reason || `The connection closed with code ${code} and no reason.`;
      this.view.fail({ title: "The stream broke off", detail });
    }
    this.onEnd();
  }
}

function startMessage(setup) {
  const { encoding, sampleRate, channels } = setup.header;
  const map = setup.array.channelMap;
  const output = { interval_ms: 100, include: ["spectrum"] };
  if (setup.numSources) output.num_sources = setup.numSources;
  return {
    type: "start",
    audio: { encoding, sample_rate: sampleRate, channels },
    array: setup.array.message,
    ...(map ? { channel_map: map.replace(/[[\]]/g, "").split(",").map(Number) } : {}),
    ...setup.method,
    output,
    overflow: "drop_oldest",
    client: CLIENT,
    noise: "none", // what is kept under a client's name was learnt from another recording
  };
}
