// Listening to one microphone of a recording while the dial follows.

const MAX_BYTES = 96 * 2 ** 20; // a browser holds a decoded recording whole

export class Player {
  #context = null;
  #node = null;
  #buffer = null;
  #file = null;
  #turn = 0; // counts calls, so that one overtaken while decoding plays nothing
  #began = 0; // seconds of the context's clock at which the recording's start would have sounded

  /** `onTime` gets the second that sounds, or null once nothing does any more. */
  constructor(button, onTime, onFailure) {
    this.button = button;
    this.onTime = onTime;
    this.onFailure = onFailure;
  }

  /** Offer a recording; `channel` is the one to hear. */
  offer(file, channel) {
    this.stop();
    this.#buffer = null;
    this.#file = file;
    this.channel = channel;
    this.button.hidden = file.size > MAX_BYTES;
  }

  get playing() {
    return this.#node !== null;
  }

  /** Play from a second on. */
  async play(from) {
    this.stop();
    const turn = this.#turn;
    try {
      this.#context ??= new AudioContext();
      await this.#context.resume();
      this.#buffer ??= await this.#decode();
    } catch {
      this.onFailure("This browser cannot play the recording.");
      return;
    }
    if (turn !== this.#turn) return;
    const node = this.#context.createBufferSource();
    node.buffer = this.#buffer;
    node.connect(this.#context.destination);
    node.onended = () => node === this.#node && this.stop();
    node.start(0, from);
    this.#node = node;
    this.#began = this.#context.currentTime - from;
    this.button.textContent = "Pause";
    this.#follow();
  }

  stop() {
    this.#turn += 1;
    const node = this.#node;
    this.#node = null;
    node?.stop();
    this.button.textContent = "Listen";
    if (node) this.onTime(null);
  }

  #follow = () => {
    if (!this.#node) return;
    this.onTime(this.#context.currentTime - this.#began);
    requestAnimationFrame(this.#follow);
  };

  /** One channel: a browser would mix all microphones into the loudspeakers. */
  async #decode() {
    const all = await this.#context.decodeAudioData(await this.#file.arrayBuffer());
    const one = this.#context.createBuffer(1, all.length, all.sampleRate);
    one.copyToChannel(all.getChannelData(Math.min(this.channel, all.numberOfChannels - 1)), 0);
    return one;
  }
}
