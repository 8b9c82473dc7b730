// Colours of sources: the style sheet holds them, light and dark; a source keeps its own.

import { difference } from "./angles.js";

export const COUNT = 6;
/** The slot of what belongs to no source of its own. */
export const OTHER = "other";
const NEAR = 20; // degrees within which a direction is taken for a source of the summary

/** The value of a colour of the style sheet, for canvases. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}

/** Call back whenever light turns to dark or the other way. */
export function onThemeChange(callback) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", callback);
}

/** Slots by track id, in the order in which the tracks appear. */
export class TrackColours {
  #slots = new Map();

  of(id) {
    if (!this.#slots.has(id)) this.#slots.set(id, this.#slots.size % COUNT);
    return this.#slots.get(id);
  }
}

/** The slot of every source of a recording: by its id where it has one, else by its direction. */
export class RecordingColours {
  #tracks = new TrackColours();
  #summary;

  constructor(answer) {
    this.#summary = answer.summary.sources;
    this.hasIds = answer.windows.some((w) => w.sources.some((s) => (s.id ?? null) !== null));
    this.answer = answer;
    for (const window of answer.windows) for (const source of window.sources) this.of(source);
  }

  of(source) {
    if ((source.id ?? null) !== null) return this.#tracks.of(source.id);
    return this.hasIds ? OTHER : this.#nearest(source.azimuth_deg);
  }

  /** The slot of a summary's source: that of most dots near it. */
  ofSummary(source) {
    if (!this.hasIds) return this.#nearest(source.azimuth_deg);
    const votes = new Map();
    for (const { sources } of this.answer.windows) {
      for (const heard of sources) {
        if (Math.abs(difference(heard.azimuth_deg, source.azimuth_deg)) > NEAR) continue;
        const slot = this.of(heard);
        votes.set(slot, (votes.get(slot) ?? 0) + 1);
      }
    }
    return [...votes].sort((a, b) => b[1] - a[1])[0]?.[0] ?? OTHER;
  }

  #nearest(azimuth) {
    let best = OTHER;
    let least = NEAR;
    this.#summary.forEach((source, index) => {
      const distance = Math.abs(difference(source.azimuth_deg, azimuth));
      if (distance < least) [best, least] = [index % COUNT, distance];
    });
    return best;
  }
}
