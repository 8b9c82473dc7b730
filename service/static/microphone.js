// The two channels of this device's own microphone, where the browser gives them, as a stream.

import { interleaved } from "./samples.js";
import { Sender } from "./sender.js";

const CHANNELS = 2;
const LATE = 0.5; // seconds of audio that wait for the network; more is left out
const RAW = { echoCancellation: false, noiseSuppression: false, autoGainControl: false };

/** Whether this browser gives microphones to this page: only to safe addresses. */
export const hasMicrophone = () =>
  Boolean(navigator.mediaDevices?.getUserMedia && window.AudioWorkletNode);

export class Microphone {
  #stream = null;
  #context = null;
  #closed = false;

  /** `spacing` is the distance of the microphones in metres; `onEnd` is called when all is over. */
  constructor(spacing, view, onEnd) {
    this.view = view;
    this.onEnd = onEnd;
    view.begin("Waiting for the microphone…");
    this.#open(spacing).catch((error) => {
      if (!this.#closed) view.fail({ title: "The microphone cannot be used", detail: reason(error) });
      this.#silence();
      onEnd();
    });
  }

  get session() {
    return this.sender?.session ?? null;
  }

  /** Send no more audio; the last results and the summary follow. */
  stop() {
    this.#silence();
    if (this.sender) this.sender.stop();
    else this.close();
  }

  /** Leave at once; the view belongs to another stream. */
  close() {
    this.#closed = true;
    this.#silence();
    this.sender?.abandon();
  }

  async #open(spacing) {
    const audio = { channelCount: { ideal: CHANNELS }, ...RAW };
    this.#stream = await navigator.mediaDevices.getUserMedia({ audio });
    const context = (this.#context = new AudioContext());
    await context.audioWorklet.addModule("static/capture.js");
    if (this.#closed) return this.#silence();
    const capture = new AudioWorkletNode(context, "capture", { numberOfOutputs: 0 });
    context.createMediaStreamSource(this.#stream).connect(capture);
    capture.port.onmessage = ({ data: channels }) => this.#heard(channels, spacing);
  }

  /** The first block tells how many channels there are. */
  #heard(channels, spacing) {
    if (this.#closed || !this.#context) return;
    if (!this.sender) {
      if (channels.length === CHANNELS) this.#begin(spacing);
      else this.#refuse(channels.length);
      return;
    }
    const bytesPerSecond = this.#context.sampleRate * CHANNELS * Float32Array.BYTES_PER_ELEMENT;
    if (this.ready && this.sender.waiting < LATE * bytesPerSecond) {
      this.sender.send(interleaved(channels));
    }
  }

  #begin(spacing) {
    const audio = {
      encoding: "pcm_f32le",
      sample_rate: this.#context.sampleRate,
      channels: CHANNELS,
    };
    const positions = [spacing / 2, -spacing / 2].map((y) => [0, y, 0]);
    const array = { name: "browser-microphone", positions_m: positions };
    this.sender = new Sender({ audio, array, client: "browser-microphone" }, this.view, {
      onReady: () => {
        this.ready = true;
        this.view.say("Hearing this device's microphone.", "live");
      },
      onEnd: () => {
        this.#silence();
        this.onEnd();
      },
    });
  }

  #refuse(count) {
    const detail = `It gives ${count} channel, and a direction needs two. Some devices have two in a browser, many have one.`;
    this.view.fail({ title: "The microphone cannot be used", detail });
    this.close();
    this.onEnd();
  }

  /** Give the microphone back. */
  #silence() {
    this.#stream?.getTracks().forEach((track) => track.stop());
    this.#context?.close();
    this.#stream = this.#context = null;
  }
}

function reason(error) {
  if (error.name === "NotAllowedError") return "The browser was not allowed to use it.";
  if (error.name === "NotFoundError") return "This device has none.";
  return error.message;
}
