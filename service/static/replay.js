// A recording sent as a robot would send its microphones: at its own pace.

import { Sender } from "./sender.js";

const STEP_MS = 60;
const MAX_BYTES = 64 * 1024; // of one message
const LATE = 1.0; // seconds; a page that slept longer goes on from where it is
const MAX_NAME = 64;

export class Replay {
  #timer = 0;
  #sent = 0; // frames

  /** `samples` are as `openSamples` gives them; `onEnd` is called once when the stream is over. */
  constructor(setup, samples, view, onEnd) {
    const { name } = setup.file;
    this.samples = samples;
    view.begin(`Sending ${name}…`);
    this.sender = new Sender(startOf(setup, samples), view, {
      onReady: () => {
        this.began = performance.now();
        view.say(`Replaying ${name}.`, "live");
        this.#send();
      },
      onEnd,
    });
  }

  get session() {
    return this.sender.session;
  }

  /** Send no more audio; the last results and the summary follow. */
  stop() {
    this.sender.stop();
  }

  /** Leave at once; the view belongs to another stream. */
  close() {
    clearTimeout(this.#timer);
    this.sender.abandon();
  }

  async #send() {
    const { sampleRate: rate, frames, frameBytes } = this.samples;
    const most = Math.floor(MAX_BYTES / frameBytes);
    let due = ((performance.now() - this.began) / 1000) * rate;
    if (due - this.#sent > LATE * rate) {
      this.began = performance.now() - (this.#sent / rate) * 1000;
      due = this.#sent;
    }
    const goal = Math.min(frames, Math.ceil(due));
    while (this.#sent < goal) {
      const from = this.#sent;
      this.#sent = Math.min(goal, from + most);
      const samples = await this.samples.read(from, this.#sent);
      if (!this.sender.open) return;
      this.sender.send(samples);
    }
    if (this.#sent >= frames) this.stop();
    else this.#timer = setTimeout(() => this.#send(), STEP_MS);
  }
}

function startOf(setup, { encoding, sampleRate, channels }) {
  const map = setup.array.channelMap;
  const output = { interval_ms: 100, include: ["spectrum"] };
  if (setup.numSources) output.num_sources = setup.numSources;
  return {
    audio: { encoding, sample_rate: sampleRate, channels },
    array: setup.array.message,
    ...(map ? { channel_map: map.match(/\d+/g).map(Number) } : {}),
    ...setup.method,
    ...setup.hemisphere,
    output,
    client: clientName(setup.file.name),
  };
}

/** The file's name, of the letters that names of clients have. */
function clientName(name) {
  return `replay-${name.normalize("NFKD").replace(/[^\w.-]+/g, "-")}`.slice(0, MAX_NAME);
}
