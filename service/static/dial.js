// The dial: the spatial spectrum around the array, with a needle for every source.

import { difference, inWords, label, onScreen, wrapped } from "./angles.js";
import { microphones } from "./array-plot.js";
import { shape } from "./dom.js";

const RIM = 200;
const HUB = 62; // radius of the disc in the middle that shows the array
const ARRAY = 30; // radius that the array is drawn with
const EASE = 0.34; // of the way to the new spectrum in every frame
const SETTLED = 0.002;
const CHIP_RADII = [150, 112]; // of a needle's label, the second where two are close
const CLOSE = 19; // degrees
const SIDES = [[0, "front"], [90, "left"], [180, "back"], [270, "right"]];

export class Dial {
  #shown = new Float32Array(360);
  #target = new Float32Array(360);
  #frame = 0;
  #calm = matchMedia("(prefers-reduced-motion: reduce)");

  constructor(figure) {
    this.spectrum = shape("path", { class: "spectrum" });
    this.needles = shape("g", { class: "needles" });
    this.hub = shape("g", { class: "hub" });
    this.picture = shape(
      "svg",
      { viewBox: "-258 -258 516 516", role: "img" },
      shape("circle", { class: "face", r: RIM }),
      ...grid(),
      this.spectrum,
      ...scale(),
      shape("circle", { class: "hub-face", r: HUB }),
      this.hub,
      this.needles,
    );
    figure.prepend(this.picture);
    this.rest();
  }

  /** Draw the array in the middle, to scale. */
  setArray(positions) {
    this.hub.replaceChildren(microphones(positions, ARRAY, { dot: 4.4 }));
  }

  /** Nothing is heard. */
  rest() {
    this.show({ spectrum: null, sources: [] });
  }

  /**
   * Show one window.
   * @param spectrum 360 values of at most 1, or null
   * @param sources with `azimuth`, `confidence`, `slot` (colour), and optionally `id` and `active`
   */
  show({ spectrum, sources }) {
    for (let degree = 0; degree < 360; degree += 1) {
      this.#target[degree] = Math.min(1, Math.max(0, spectrum?.[degree] ?? 0));
    }
    this.needles.replaceChildren(...withChips(sources).map(needle));
    this.picture.setAttribute("aria-label", describe(sources));
    if (this.#calm.matches) this.#shown.set(this.#target);
    if (!this.#frame) this.#draw();
  }

  #draw = () => {
    let rest = 0;
    for (let degree = 0; degree < 360; degree += 1) {
      const step = this.#target[degree] - this.#shown[degree];
      this.#shown[degree] += Math.abs(step) < SETTLED ? step : step * EASE;
      rest = Math.max(rest, Math.abs(step));
    }
    this.spectrum.setAttribute("d", outline(this.#shown));
    this.#frame = rest < SETTLED ? 0 : requestAnimationFrame(this.#draw);
  };
}

function outline(values) {
  if (values.every((value) => value === 0)) return "";
  let path = "";
  values.forEach((value, degree) => {
    const [x, y] = onScreen(HUB + value * (RIM - HUB), degree);
    path += `${path ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
  });
  return `${path}Z`;
}

function grid() {
  const rings = [1 / 3, 2 / 3].map((part) =>
    shape("circle", { class: "ring", r: HUB + part * (RIM - HUB) }),
  );
  const spokes = Array.from({ length: 12 }, (_, index) => line(HUB, RIM, index * 30, "spoke"));
  return [...rings, ...spokes];
}

function scale() {
  const marks = [shape("circle", { class: "rim", r: RIM })];
  for (let degree = 0; degree < 360; degree += 5) {
    const length = degree % 30 === 0 ? 11 : degree % 10 === 0 ? 7 : 4;
    marks.push(line(RIM, RIM + length, degree, "tick"));
  }
  for (let degree = 0; degree < 360; degree += 30) {
    const side = SIDES.find(([azimuth]) => azimuth === degree);
    const [x, y] = onScreen(RIM + (degree % 180 === 90 ? 32 : 28), degree);
    const at = (dy) => ({ x: x.toFixed(1), y: (y + dy).toFixed(1) });
    if (side) marks.push(shape("text", { class: "side", ...at(-8), text: side[1] }));
    marks.push(shape("text", { class: "degree", ...at(side ? 9 : 0), text: `${degree}°` }));
  }
  return marks;
}

function line(from, to, degree, kind) {
  const [x1, y1] = onScreen(from, degree);
  const [x2, y2] = onScreen(to, degree);
  const ends = { x1: x1.toFixed(1), y1: y1.toFixed(1), x2: x2.toFixed(1), y2: y2.toFixed(1) };
  return shape("line", { class: kind, ...ends });
}

/** Sources with the radius of their labels: neighbours take turns. */
function withChips(sources) {
  const placed = [];
  for (const source of sources) {
    const crowded = placed.filter((p) => Math.abs(difference(p.azimuth, source.azimuth)) < CLOSE);
    placed.push({ ...source, radius: CHIP_RADII[crowded.length % CHIP_RADII.length] });
  }
  return placed;
}

function needle({ azimuth, confidence, slot, id, active = true, radius }) {
  const known = (id ?? null) !== null;
  const text = known ? `${label(azimuth)} #${id}` : label(azimuth);
  const half = 10 + text.length * 5.5;
  const [x, y] = onScreen(radius, azimuth);
  const [tipX, tipY] = onScreen(RIM - 1, azimuth);
  const group = shape("g", { class: `needle${active ? "" : " coasting"}`, "data-slot": slot });
  const hand = line(HUB + 2, RIM - 6, azimuth, "hand");
  hand.setAttribute("opacity", (0.35 + 0.65 * Math.min(1, confidence)).toFixed(2));
  const chip = { x: x - half, y: y - 15, width: 2 * half, height: 30, rx: 8 };
  group.append(
    hand,
    shape("path", {
      class: "tip",
      d: "M0 -2-8 13H8Z",
      transform: `translate(${tipX.toFixed(1)} ${tipY.toFixed(1)}) rotate(${(-wrapped(azimuth)).toFixed(1)})`,
    }),
    shape("rect", { class: "chip", ...chip }),
    shape("text", { class: "chip-text", x: x.toFixed(1), y: (y + 1).toFixed(1), text }),
  );
  return group;
}

function describe(sources) {
  if (!sources.length) return "Dial with no source.";
  const named = sources.map(({ azimuth }) => `${label(azimuth)}, ${inWords(azimuth)}`);
  return `Dial, seen from above. Sources at ${named.join("; ")}.`;
}
