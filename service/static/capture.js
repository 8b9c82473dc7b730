// Runs beside the page, on the browser's thread for audio: collects blocks of all channels.

const BLOCK = 2048; // samples in one message

class Capture extends AudioWorkletProcessor {
  #blocks = [];
  #length = 0;

  process([channels]) {
    if (!channels.length) return true; // nothing is connected yet
    this.#blocks.push(channels.map((samples) => samples.slice()));
    this.#length += channels[0].length;
    if (this.#length < BLOCK) return true;
    const joined = channels.map((_, channel) => {
      const samples = new Float32Array(this.#length);
      let at = 0;
      for (const block of this.#blocks) {
        samples.set(block[channel] ?? block[0], at);
        at += block[0].length;
      }
      return samples;
    });
    this.port.postMessage(joined);
    this.#blocks = [];
    this.#length = 0;
    return true;
  }
}

registerProcessor("capture", Capture);
