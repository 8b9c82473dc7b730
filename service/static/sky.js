// The sky view: directions with their elevations, seen from above as the dial is. The middle is
// straight up, the rim the horizon; what is below the horizon is drawn hollow, and for it the middle
// is straight down.

import { inWords, label, onScreen } from "./angles.js";
import { shape } from "./dom.js";

const RIM = 100; // radius of the horizon
const RINGS = [30, 60]; // degrees of elevation
const SIDES = [[0, "front"], [90, "left"], [180, "back"], [270, "right"]];
const MAX_DOTS = 1500; // of a path; a long recording's are thinned out

export class Sky {
  /** `figure` is hidden until there are elevations. */
  constructor(figure) {
    this.figure = figure;
    this.trail = shape("g", { class: "trail" });
    this.marks = shape("g", { class: "marks" });
    this.picture = shape(
      "svg",
      { viewBox: "-142 -124 284 248", role: "img" },
      shape("circle", { class: "face", r: RIM }),
      ...RINGS.map((elevation) => shape("circle", { class: "ring", r: radius(elevation) })),
      ...[0, 45, 90, 135].map(spoke),
      shape("circle", { class: "rim", r: RIM }),
      shape("circle", { class: "zenith", r: 2 }),
      ...RINGS.map((elevation) =>
        shape("text", { class: "degree", x: 3, y: -radius(elevation), text: `${elevation}°` }),
      ),
      ...SIDES.map(side),
      this.trail,
      this.marks,
    );
    figure.prepend(this.picture);
    this.rest();
  }

  /** Whether the array tells elevations: only then is there a sky. */
  set told(told) {
    this.figure.hidden = !told;
  }

  /** Nothing is heard, and nothing was. */
  rest() {
    this.told = false;
    this.setTrail([]);
    this.show([]);
  }

  /** Show where sources were: `azimuth`, `elevation`, `slot` of each. */
  setTrail(points) {
    const known = points.filter(({ elevation }) => (elevation ?? null) !== null);
    const every = Math.ceil(known.length / MAX_DOTS);
    this.trail.replaceChildren(...known.filter((_, index) => index % every === 0).map(dot));
  }

  /** Show the sources of one moment, as the dial takes them. */
  show(sources) {
    const known = sources.filter(({ elevation }) => (elevation ?? null) !== null);
    this.marks.replaceChildren(...known.map(mark));
    this.picture.setAttribute("aria-label", describe(known));
  }
}

/** Distance from the middle: evenly spaced in elevation. */
const radius = (elevation) => (RIM * (90 - Math.abs(elevation))) / 90;

const isBelow = (elevation) => Math.round(elevation) < 0;

function dot({ azimuth, elevation, slot }) {
  const [x, y] = onScreen(radius(elevation), azimuth);
  const kind = isBelow(elevation) ? "below" : "above";
  return shape("circle", { class: kind, cx: x.toFixed(1), cy: y.toFixed(1), r: 2, "data-slot": slot });
}

function mark({ azimuth, elevation, slot, active = true }) {
  const [x, y] = onScreen(radius(elevation), azimuth);
  const text = `${Math.round(elevation)}°`.replace("-", "−").replace("−0", "0");
  const kind = `${isBelow(elevation) ? "below" : "above"}${active ? "" : " coasting"}`;
  const at = { x: x.toFixed(1), y: (y + (y < -RIM / 2 ? 17 : -16)).toFixed(1) };
  return shape(
    "g",
    { class: kind, "data-slot": slot, "data-azimuth": azimuth, "data-elevation": elevation },
    shape("circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: 8 }),
    shape("text", { ...at, text }),
  );
}

function spoke(azimuth) {
  const [x1, y1] = onScreen(RIM, azimuth);
  const [x2, y2] = onScreen(RIM, azimuth + 180);
  const ends = { x1: x1.toFixed(1), y1: y1.toFixed(1), x2: x2.toFixed(1), y2: y2.toFixed(1) };
  return shape("line", { class: "spoke", ...ends });
}

function side([azimuth, text]) {
  const [x, y] = onScreen(RIM + (azimuth % 180 === 90 ? 17 : 13), azimuth);
  return shape("text", { class: "side", x: x.toFixed(1), y: y.toFixed(1), text });
}

function describe(sources) {
  if (!sources.length) return "Sky view with no source.";
  const named = sources.map(
    ({ azimuth, elevation }) => `${label(azimuth)}, ${inWords(azimuth, elevation)}`,
  );
  return `Sky view, straight up in the middle. Sources at ${named.join("; ")}.`;
}
