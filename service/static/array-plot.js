// Microphone arrays drawn to scale: from above, x forward is up and y left is left; from the right
// side, x forward is right and z is up.

import { shape } from "./dom.js";

const NICE_MM = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
const LEVEL = 1e-4; // metres; microphones of heights closer than this lie in one level

/** Positions on the screen, right and down, in metres. */
const ABOVE = ([x, y]) => [-y, -x];
const SIDE = ([x, , z]) => [x, -z];

/** The centre of the bounding box of points and the largest distance from it, in metres. */
function extent(points) {
  const middle = (axis) => {
    const values = points.map((p) => p[axis]);
    return (Math.min(...values) + Math.max(...values)) / 2;
  };
  const centre = [middle(0), middle(1)];
  const radius = Math.max(...points.map((p) => Math.hypot(p[0] - centre[0], p[1] - centre[1])));
  return { centre, radius };
}

/** Microphones as a group that fits a circle of this radius about the origin. */
export function microphones(positions, radius, { numbers = true, dot = 4, seen = ABOVE } = {}) {
  const group = shape("g", { class: "microphones" });
  if (!positions.length) return group;
  const points = positions.map(seen);
  const { centre, radius: reach } = extent(points);
  const scale = reach > 0 ? radius / reach : 0;
  points.forEach((point, index) => {
    const here = points.flatMap((p, n) => (Math.hypot(p[0] - point[0], p[1] - point[1]) < LEVEL ? [n] : []));
    if (here[0] !== index) return; // one behind another, as seen from here
    const [right, down] = [(point[0] - centre[0]) * scale, (point[1] - centre[1]) * scale];
    group.append(shape("circle", { cx: right.toFixed(2), cy: down.toFixed(2), r: dot }));
    if (!numbers) return;
    const away = Math.hypot(right, down) > 1 ? Math.atan2(down, right) : Math.PI / 2;
    const [dx, dy] = [Math.cos(away) * dot * 2.8, Math.sin(away) * dot * 2.8];
    group.append(
      shape("text", { x: (right + dx).toFixed(2), y: (down + dy).toFixed(2), text: here.join(" ") }),
    );
  });
  return group;
}

/** Pictures of an array with axes and a scale bar: from above, and from the side where it has height. */
export function arrayPlots(positions) {
  const count = `${positions.length} microphones`;
  const above = picture(`The array seen from above: ${count}`, positions, ABOVE, {
    axes: "M0 52V-54M-3 -49 0 -55 3 -49M52 0H-54M-49 -3-55 0-49 3",
    names: [["x", 7, -52], ["y", -55, -8]],
  });
  const heights = positions.map(([, , z]) => z);
  if (!(Math.max(...heights) - Math.min(...heights) > LEVEL)) return [above];
  const side = picture(`The array seen from its right side: ${count}`, positions, SIDE, {
    axes: "M0 52V-54M-3 -49 0 -55 3 -49M-52 0H54M49 -3 55 0 49 3",
    names: [["z", 7, -52], ["x", 53, -8]],
  });
  return [above, side];
}

function picture(described, positions, seen, { axes, names }) {
  const drawn = shape("svg", { viewBox: "-60 -60 120 136", role: "img", "aria-label": described });
  drawn.append(
    shape("path", { class: "axis", d: axes }),
    ...names.map(([text, x, y]) => shape("text", { class: "axis-name", x, y, text })),
    microphones(positions, 36, { dot: 3.2, seen }),
  );
  const { radius } = positions.length ? extent(positions.map(seen)) : { radius: 0 };
  if (radius > 0 && Number.isFinite(radius)) drawn.append(scaleBar(radius, 36));
  return drawn;
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
