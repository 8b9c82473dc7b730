// Plain words for codes. The server's own sentences are always shown beside them.

/** Warnings that leave the directions as good as they are, or that the user knows the reason of. */
const MINOR = {
  audio_dropped: "Audio was dropped",
  audio_gap: "Audio is missing",
  non_finite: "Broken samples",
  quiet: "Very quiet",
  clipping: "Clipping",
  dc_offset: "Constant offset",
  band_limited: "High frequencies are missing",
  length_unknown: "The recording's length is not known",
  too_short: "Too short",
  channel_map_assumed: "The device's channels were assumed",
  no_model_for_array: "No model for this array",
  calibration_failed: "The calibration failed",
};

/** Warnings under which directions may be wrong. */
const SERIOUS = {
  channel_dead: "A microphone is silent",
  channels_identical: "Channels are copies",
  channel_late: "A channel comes late",
  channel_inverted: "A channel is inverted",
  channel_order: "Channels seem swapped",
  array_scale: "The array's size does not fit",
  channel_processed: "A channel is processed",
  sample_rate_wrong: "The sample rate does not fit",
  front_back_ambiguous: "Front and back look alike",
  noise_mismatch: "The noise has changed",
  pose_stale: "The robot no longer says how it is turned",
};

const REASONS = {
  silence: "It is quiet.",
  no_direction: "There is sound, but from no clear direction.",
  unconfirmed: "Something may be there; it is not sure yet.",
  excluded: "Sound comes only from sectors that are excluded.",
  warming_up: "Listening has just begun.",
};

export const METHODS = {
  neural: "neural covariance and MUSIC",
  norm_music: "normalised MUSIC",
  music: "MUSIC",
  srp_phat: "SRP-PHAT",
  gcc_phat: "GCC-PHAT",
};

/** What a warning is about. */
export function warningTitle(code) {
  return SERIOUS[code] ?? MINOR[code] ?? capital(String(code).replaceAll("_", " "));
}

/** A text that begins with a capital. */
export const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

/** Whether a warning belongs beside the directions; one that is new to this page does. */
export const isSerious = (code) => !(code in MINOR);

/** A confidence for people: never "100 %", which no estimate is. */
export const percent = (confidence) => `${Math.min(99, Math.round(100 * confidence))} %`;

/** Why there is no source. */
export const whyNoSource = (reason) => REASONS[reason] ?? "No source.";

/** A duration for people: 8.5 s, 2 min 05 s. */
export function duration(seconds) {
  if (seconds < 60) return `${seconds.toFixed(1)} s`;
  const whole = Math.round(seconds);
  return `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
}

/** A count with its noun. */
export const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
