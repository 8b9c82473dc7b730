// Azimuths in degrees, counter-clockwise from straight ahead; on the screen ahead is up and left
// is left.

const SECTORS = [
  "front", "front left", "left", "back left", "back", "back right", "right", "front right",
];

/** An azimuth in [0, 360). */
export const wrapped = (degrees) => ((degrees % 360) + 360) % 360;

/** The signed difference a - b in [-180, 180). */
export const difference = (a, b) => wrapped(a - b + 180) - 180;

/** Where something lies, in words; its elevation where that is known and not level. */
export function inWords(azimuth, elevation = null) {
  const sector = SECTORS[Math.round(wrapped(azimuth) / 45) % 8];
  const height = Math.round(elevation ?? 0);
  return height ? `${sector}, ${Math.abs(height)}° ${height > 0 ? "up" : "down"}` : sector;
}

/** A rounded azimuth with its sign: 359.7 is 0°, not 360°. */
export const label = (degrees) => `${Math.round(degrees) % 360}°`;

/** The point [x, y] of the screen at a radius and an azimuth. */
export function onScreen(radius, degrees) {
  const angle = (degrees * Math.PI) / 180;
  return [-radius * Math.sin(angle), -radius * Math.cos(angle)];
}
