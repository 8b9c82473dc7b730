// What a recording's header says: WAV entirely, of FLAC what its first block tells. The browser's
// own decoder mixes channels down and resamples, so it is not asked.

const HEAD_BYTES = 256 * 1024;
const PCM = 1;
const FLOAT = 3;
const EXTENSIBLE = 0xfffe;

/** Encodings of the stream by format and bits per sample. */
const ENCODINGS = {
  [`${PCM}/16`]: "pcm_s16le",
  [`${PCM}/24`]: "pcm_s24le",
  [`${PCM}/32`]: "pcm_s32le",
  [`${FLOAT}/32`]: "pcm_f32le",
};

/**
 * Read a file's header.
 * @returns `kind` ("wav", "flac" or null), and where known `channels`, `sampleRate` (Hz),
 * `seconds`; for WAV also `encoding` (null where the stream has none for it), `blockAlign` (bytes
 * of a sample frame) and the `start` and `end` of the samples in the file
 */
export async function readHeader(file) {
  const view = new DataView(await file.slice(0, HEAD_BYTES).arrayBuffer());
  const magic = text(view, 0, 4);
  if (["RIFF", "RF64", "BW64"].includes(magic) && text(view, 8, 4) === "WAVE") {
    return readWav(view, file.size) ?? { kind: null };
  }
  if (magic === "fLaC") return readFlac(view) ?? { kind: null };
  return { kind: null };
}

function readWav(view, size) {
  let format = null;
  for (let at = 12; at + 8 <= view.byteLength; ) {
    const [name, length] = [text(view, at, 4), view.getUint32(at + 4, true)];
    const begin = at + 8;
    if (name === "fmt " && begin + 16 <= view.byteLength) format = readFormat(view, begin, length);
    if (name === "data" && format) {
      // A recorder that was cut off leaves 0 or 0xffffffff here: take what there is.
      const known = length > 0 && begin + length <= size;
      return withSamples(format, begin, known ? begin + length : size);
    }
    at = begin + length + (length % 2);
  }
  return format && { kind: "wav", ...format, encoding: null };
}

function readFormat(view, at, length) {
  let tag = view.getUint16(at, true);
  const bits = view.getUint16(at + 14, true);
  if (tag === EXTENSIBLE && length >= 40) tag = view.getUint16(at + 24, true);
  return {
    channels: view.getUint16(at + 2, true),
    sampleRate: view.getUint32(at + 4, true),
    blockAlign: view.getUint16(at + 12, true),
    encoding: ENCODINGS[`${tag}/${bits}`] ?? null,
  };
}

function withSamples(format, start, end) {
  const frames = Math.floor((end - start) / (format.blockAlign || 1));
  const seconds = frames / (format.sampleRate || 1);
  return { kind: "wav", ...format, start, end: start + frames * format.blockAlign, seconds };
}

/** STREAMINFO, always the first block: 20 bits of rate, 3 of channels, 5 of depth, 36 of length. */
function readFlac(view) {
  if (view.byteLength < 26) return null;
  const rateAndChannels = view.getUint32(18);
  const sampleRate = rateAndChannels >>> 12;
  const channels = ((rateAndChannels >>> 9) & 7) + 1;
  const frames = (view.getUint8(21) & 15) * 2 ** 32 + view.getUint32(22);
  const seconds = frames && sampleRate ? frames / sampleRate : null;
  return { kind: "flac", channels, sampleRate, seconds };
}

function text(view, at, length) {
  if (at + length > view.byteLength) return "";
  return String.fromCharCode(...new Uint8Array(view.buffer, at, length));
}
