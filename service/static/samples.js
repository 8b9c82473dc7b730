// The samples of a file as a stream takes them: those of WAV as they are stored, all others as the
// browser decodes them, every channel by itself.

const MAX_BYTES = 512 * 2 ** 20; // a browser holds a decoded recording whole
const DEFAULT_RATE = 48000; // hertz, where the header is not understood
const FLOAT_BYTES = 4;

/** Why a file's samples cannot be read here. */
export class Unreadable extends Error {}

/**
 * Open a file by its header, as `readHeader` gives it; an Unreadable says why that is not possible.
 * @returns `encoding`, `sampleRate` (Hz), `channels`, `frameBytes` (of one sample of all channels),
 * `frames`, and `read`, which promises the bytes of the frames from one number to another
 */
export async function openSamples(file, header) {
  if (header.kind !== "wav" || !header.encoding || !header.end) return decoded(file, header);
  const { encoding, sampleRate, channels, blockAlign: frameBytes, start, end } = header;
  const read = (from, to) =>
    file.slice(start + from * frameBytes, start + to * frameBytes).arrayBuffer();
  return { encoding, sampleRate, channels, frameBytes, frames: (end - start) / frameBytes, read };
}

async function decoded(file, { channels: known, sampleRate = DEFAULT_RATE, seconds }) {
  const bytes = Math.max(file.size, (seconds ?? 0) * sampleRate * (known ?? 1) * FLOAT_BYTES);
  if (bytes > MAX_BYTES) {
    throw new Unreadable(`${file.name} is too long for a browser to decode. Convert it to WAV.`);
  }
  const buffer = await decode(file, sampleRate);
  const channels = buffer.numberOfChannels;
  if (known && known !== channels) {
    throw new Unreadable(
      `This browser gives ${channels} of the ${known} channels of ${file.name}. Convert it to WAV.`,
    );
  }
  const all = Array.from({ length: channels }, (_, channel) => buffer.getChannelData(channel));
  return {
    encoding: "pcm_f32le",
    sampleRate,
    channels,
    frameBytes: channels * FLOAT_BYTES,
    frames: buffer.length,
    read: async (from, to) => interleaved(all.map((samples) => samples.subarray(from, to))),
  };
}

async function decode(file, sampleRate) {
  try {
    // At the file's own rate, so that nothing is resampled.
    const context = new OfflineAudioContext(1, 1, sampleRate);
    return await context.decodeAudioData(await file.arrayBuffer());
  } catch {
    throw new Unreadable(
      `This browser cannot decode ${file.name}, which a stream needs; Localize may. Convert it, for example: ffmpeg -i ${file.name} recording.wav`,
    );
  }
}

/** Channels as the bytes of one sample after the other. */
export function interleaved(channels) {
  const samples = new Float32Array(channels.length * channels[0].length);
  channels.forEach((channel, n) => {
    for (let t = 0, at = n; t < channel.length; t += 1, at += channels.length) samples[at] = channel[t];
  });
  return samples.buffer;
}
