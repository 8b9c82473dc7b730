// Microphone arrays drawn to scale, seen from above: x forward is up, y left is left.

import { shape } from "./dom.js";

const NICE_MM = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];

/** The centre of an array's bounding box and the largest distance from it, in metres. */
export function extent(positions) {
  const middle = (axis) => {
    const values = positions.map((p) => p[axis]);
    return (Math.min(...values) + Math.max(...values)) / 2;
  };
  const centre = [middle(0), middle(1)];
  const radius = Math.max(...positions.map((p) => Math.hypot(p[0] - centre[0], p[1] - centre[1])));
  return { centre, radius };
}

/** Microphones as a group that fits a circle of this radius about the origin. */
export function microphones(positions, radius, { numbers = true, dot = 4 } = {}) {
  const group = shape("g", { class: "microphones" });
  if (!positions.length) return group;
  const { centre, radius: reach } = extent(positions);
  const scale = reach > 0 ? radius / reach : 0;
  positions.forEach(([x, y], index) => {
    const [left, up] = [-(y - centre[1]) * scale, -(x - centre[0]) * scale];
    group.append(shape("circle", { cx: left.toFixed(2), cy: up.toFixed(2), r: dot }));
    if (!numbers) return;
    const away = Math.hypot(left, up) > 1 ? Math.atan2(up, left) : Math.PI / 2;
    const [dx, dy] = [Math.cos(away) * dot * 2.8, Math.sin(away) * dot * 2.8];
    group.append(
      shape("text", { x: (left + dx).toFixed(2), y: (up + dy).toFixed(2), text: String(index) }),
    );
  });
  return group;
}

/** An array with axes and a scale bar, as a picture of its own. */
export function arrayPlot(positions) {
  const described = `The array seen from above: ${positions.length} microphones`;
  const picture = shape("svg", { viewBox: "-60 -60 120 136", role: "img", "aria-label": described });
  picture.append(
    shape("path", { class: "axis", d: "M0 52V-54M-3 -49 0 -55 3 -49M52 0H-54M-49 -3-55 0-49 3" }),
    shape("text", { class: "axis-name", x: 7, y: -52, text: "x" }),
    shape("text", { class: "axis-name", x: -55, y: -8, text: "y" }),
    microphones(positions, 36, { dot: 3.2 }),
  );
  const { radius } = positions.length ? extent(positions) : { radius: 0 };
  if (radius > 0 && Number.isFinite(radius)) picture.append(scaleBar(radius, 36));
  return picture;
}

function scaleBar(radius, drawn) {
  const perMm = drawn / (radius * 1000);
  const length = NICE_MM.findLast((mm) => mm * perMm <= 44) ?? NICE_MM[0];
  const half = (length * perMm) / 2;
  return shape(
    "g",
    { class: "scale" },
    shape("path", { d: `M${-half} 57v5H${half}v-5` }),
    shape("text", { x: 0, y: 69, text: `${length} mm` }),
  );
}
