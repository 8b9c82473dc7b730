// What can be said of microphone positions: size, spacing, and what to look out for.

const SPEED_OF_SOUND = 343; // m/s
const TOLERANCE = 1e-4; // metres within which microphones lie on one line or in one plane
const LARGE = 1.0; // metres; more is most likely a slip
const SAME_PLACE = 1e-6; // metres

const between = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

function* pairs(positions) {
  for (let i = 0; i < positions.length; i += 1) {
    for (let j = i + 1; j < positions.length; j += 1) yield [i, j];
  }
}

/** Largest and smallest distance between microphones in metres, and the pair that is closest. */
export function spacing(positions) {
  let [largest, smallest, closest] = [0, Infinity, null];
  for (const [i, j] of pairs(positions)) {
    const distance = between(positions[i], positions[j]);
    largest = Math.max(largest, distance);
    if (distance < smallest) [smallest, closest] = [distance, [i, j]];
  }
  return { largest, smallest, closest };
}

/** Whether all microphones lie on one line, seen from above. */
export function isLinear(positions) {
  const [a] = positions;
  const b = positions.reduce((far, p) => (between(p, a) > between(far, a) ? p : far), a);
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const length = Math.hypot(dx, dy);
  if (length < TOLERANCE) return true;
  return positions.every(
    (p) => Math.abs((p[0] - a[0]) * dy - (p[1] - a[1]) * dx) / length < TOLERANCE,
  );
}

/** Facts for people. */
export function facts(positions) {
  if (positions.length < 2) return { Microphones: String(positions.length) };
  const { largest, smallest } = spacing(positions);
  const alias = smallest > 0 ? `${(SPEED_OF_SOUND / (2 * smallest) / 1000).toFixed(1)} kHz` : null;
  return {
    Microphones: String(positions.length),
    Across: millimetres(largest),
    "Closest pair": millimetres(smallest),
    "Aliasing above": alias,
  };
}

/** Why the number of a microphone on an axis cannot be, or nothing. */
export function whyWrong(positions, n, axis) {
  if (!Number.isFinite(positions[n][axis])) return `Microphone ${n} needs a number for ${"xyz"[axis]}.`;
  const twin = positions.findIndex((p, other) => other !== n && between(p, positions[n]) < SAME_PLACE);
  return twin < 0 ? "" : `Microphones ${n} and ${twin} are at the same place.`;
}

/** What the user should know before the service says no, or answers less than is hoped for. */
export function hints(positions) {
  if (positions.some((p) => p.some((value) => !Number.isFinite(value)))) {
    return ["Every position needs three numbers."];
  }
  if (positions.length < 2) return ["An array has at least two microphones."];
  const found = [];
  const { largest, smallest, closest } = spacing(positions);
  if (smallest < SAME_PLACE) {
    found.push(`Microphones ${closest[0]} and ${closest[1]} are at the same place.`);
  }
  if (largest > LARGE) {
    found.push(`${millimetres(largest)} across is large: is a digit too many, or JSON in millimetres?`);
  }
  if (largest < 0.01) found.push("Below 10 mm across, directions are coarse.");
  if (isLinear(positions)) {
    found.push("All microphones lie on one line: it cannot tell the two sides of the line apart.");
  }
  const heights = positions.map((p) => p[2]);
  if (Math.max(...heights) - Math.min(...heights) > TOLERANCE) {
    found.push("Microphones at different heights: elevations are estimated where they differ enough.");
  }
  return found;
}

const millimetres = (metres) => `${(metres * 1000).toFixed(metres < 0.1 ? 1 : 0)} mm`;
