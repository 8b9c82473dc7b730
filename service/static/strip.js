// The spatial spectrum over time as a picture: one column per result, one row per 2 degrees.

import { colour } from "./colours.js";

const ROWS = 180;
const MAX_COLUMNS = 2000;
const STRENGTH = 230; // alpha, of 255, where the spectrum is 1
const CONTRAST = 1.4; // exponent

export class Strip {
  #canvas = document.createElement("canvas");
  #context;

  constructor(columns) {
    this.#canvas.width = Math.max(1, Math.min(columns, MAX_COLUMNS));
    this.#canvas.height = ROWS;
    this.#context = this.#canvas.getContext("2d", { willReadFrequently: true });
  }

  /** The picture of a recording's spectra, evenly in time. */
  static of(spectra) {
    const strip = new Strip(spectra.length);
    const columns = strip.#canvas.width;
    const rgb = tone();
    for (let column = 0; column < columns; column += 1) {
      strip.#paint(spectra[Math.floor((column * spectra.length) / columns)], column, rgb);
    }
    return strip;
  }

  /** Move everything to the left by some columns and paint the last one. */
  push(spectrum, columns = 1) {
    const { width } = this.#canvas;
    const shift = Math.min(width, Math.max(1, columns));
    const kept = this.#context.getImageData(shift, 0, Math.max(1, width - shift), ROWS);
    this.#context.clearRect(0, 0, width, ROWS);
    if (shift < width) this.#context.putImageData(kept, 0, 0);
    for (let back = 0; back < Math.min(shift, 2); back += 1) {
      this.#paint(spectrum, width - 1 - back, tone());
    }
  }

  /** Draw into a rectangle of a canvas; of a part only the newest `share` of the columns. */
  draw(context, { x, y, width, height }, share = 1) {
    const columns = this.#canvas.width * share;
    const from = this.#canvas.width - columns;
    context.drawImage(this.#canvas, from, 0, columns, ROWS, x, y, width, height);
  }

  #paint(spectrum, column, [red, green, blue]) {
    if (!spectrum) return;
    const floor = Math.min(0.99, Math.max(0, Math.min(...spectrum))); // never zero; says nothing
    const image = this.#context.createImageData(1, ROWS);
    for (let row = 0; row < ROWS; row += 1) {
      // The top row is 180 degrees, the middle 0, the bottom -180.
      const degree = (540 - 2 * row) % 360;
      const value = Math.min(1, Math.max(0, (spectrum[degree] - floor) / (1 - floor)));
      image.data.set([red, green, blue, STRENGTH * value ** CONTRAST], 4 * row);
    }
    this.#context.putImageData(image, column, 0);
  }
}

function tone() {
  const hex = colour("spectrum");
  return [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
}
