// A synthetic scene for the chosen array: two talkers in a free field, made here, not downloaded.

export const TALKERS_DEG = [45, 200];
const TURNS = [[[0.2, 2.8], [5.2, 7.8]], [[2.8, 5.2], [5.4, 7.8]]]; // seconds, per talker
const SECONDS = 8;
const RATE = 16000;
const SPEED_OF_SOUND = 343;
const TAPS = 33; // of the fractional delays
const TILT = 0.75; // one pole: a voice is weaker the higher, above about 700 Hz
const NOISE = 0.02;
const PEAK = 0.5;

/** A WAV file of 16-bit samples with one channel per microphone. */
export function sampleFile(positions) {
  const random = generator(7);
  const channels = positions.map(() => new Float32Array(SECONDS * RATE));
  TALKERS_DEG.forEach((azimuth, talker) => {
    const voice = speech(random, TURNS[talker]);
    const [x, y] = [Math.cos((azimuth * Math.PI) / 180), Math.sin((azimuth * Math.PI) / 180)];
    positions.forEach((p, microphone) => {
      const advance = ((p[0] * x + p[1] * y) / SPEED_OF_SOUND) * RATE;
      addDelayed(channels[microphone], voice, -advance);
    });
  });
  for (const channel of channels) {
    for (let t = 0; t < channel.length; t += 1) channel[t] += NOISE * (random() - 0.5);
  }
  return new File([wav(channels)], "two-talkers.wav", { type: "audio/wav" });
}

/** Syllables: pulse trains of a random pitch with a little noise, three to six a second. */
function speech(random, turns) {
  const signal = new Float32Array(SECONDS * RATE);
  const uniform = (low, high) => low + (high - low) * random();
  for (const [begin, end] of turns) {
    let start = Math.round(begin * RATE);
    while (start < end * RATE) {
      const length = Math.round(uniform(0.12, 0.26) * RATE);
      const pitch = uniform(100, 210) / RATE;
      for (let t = 0; t < length && start + t < signal.length; t += 1) {
        const pulse = Math.floor((t + 1) * pitch) - Math.floor(t * pitch);
        const envelope = 0.5 - 0.5 * Math.cos((2 * Math.PI * t) / length);
        signal[start + t] += envelope * (pulse + 0.12 * (random() - 0.5));
      }
      start += length + Math.round(uniform(0.01, 0.06) * RATE);
    }
  }
  for (let t = 1; t < signal.length; t += 1) signal[t] += TILT * (signal[t - 1] - signal[t]);
  return signal;
}

/** Add a signal delayed by a fraction of a sample: a sinc under a Hann window. */
function addDelayed(channel, signal, delay) {
  const whole = Math.floor(delay);
  const half = (TAPS - 1) / 2;
  const taps = Array.from({ length: TAPS }, (_, index) => {
    const x = index - half - (delay - whole);
    const sinc = x === 0 ? 1 : Math.sin(Math.PI * x) / (Math.PI * x);
    return sinc * (0.5 + 0.5 * Math.cos((Math.PI * x) / (half + 1)));
  });
  for (let t = 0; t < signal.length; t += 1) {
    if (signal[t] === 0) continue;
    for (let index = 0; index < TAPS; index += 1) {
      const at = t + whole + index - half;
      if (at >= 0 && at < channel.length) channel[at] += signal[t] * taps[index];
    }
  }
}

function wav(channels) {
  const [count, frames] = [channels.length, channels[0].length];
  const view = new DataView(new ArrayBuffer(44 + 2 * count * frames));
  const letters = (at, word) => [...word].forEach((c, i) => view.setUint8(at + i, c.charCodeAt(0)));
  letters(0, "RIFF");
  view.setUint32(4, view.byteLength - 8, true);
  letters(8, "WAVEfmt ");
  view.setUint32(16, 16, true);
  view.setUint16(20, 1, true);
  view.setUint16(22, count, true);
  view.setUint32(24, RATE, true);
  view.setUint32(28, RATE * 2 * count, true);
  view.setUint16(32, 2 * count, true);
  view.setUint16(34, 16, true);
  letters(36, "data");
  view.setUint32(40, view.byteLength - 44, true);
  const loudest = channels.reduce((most, c) => c.reduce((m, v) => Math.max(m, Math.abs(v)), most), 0);
  const gain = (PEAK * 32767) / (loudest || 1);
  for (let t = 0, at = 44; t < frames; t += 1) {
    for (let n = 0; n < count; n += 1, at += 2) view.setInt16(at, channels[n][t] * gain, true);
  }
  return view.buffer;
}

/** Uniform numbers in [0, 1) that are the same each time (mulberry32). */
function generator(seed) {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}
