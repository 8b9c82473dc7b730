// Azimuth over time: a dot per source and result, ahead in the middle, left above, right below.

import { wrapped } from "./angles.js";
import { COUNT, OTHER, colour, onThemeChange } from "./colours.js";

const MARGIN = { left: 52, right: 14, top: 12, bottom: 30 };
const SIDES = [[180, "back"], [90, "left"], [0, "front"], [-90, "right"], [-180, "back"]];
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600];
const TICK_SPACE = 74; // pixels
const DOT = { least: 1.1, most: 5 };
const OUTLINED = 3; // pixels of radius; smaller dots would be all outline

export class Timeline {
  #data = { points: [], strip: null, share: 1, range: [0, 1], now: null, band: null, cursor: null, columns: 60 };
  #frame = 0;
  #layer = null; // everything but the window shown, which moves while a recording plays

  /** `onSelect` is called with a time in seconds where the user clicks. */
  constructor(canvas, onSelect = null) {
    this.canvas = canvas;
    this.onSelect = onSelect;
    new ResizeObserver(() => this.#renew()).observe(canvas);
    onThemeChange(() => this.#renew());
    if (onSelect) this.#listen();
  }

  /**
   * Change what is drawn; what is left out stays.
   * @param data.points of `t` (s), `azimuth`, `confidence`, `slot`, `active`
   * @param data.strip the spectra behind the dots, of which the newest `data.share` are drawn
   * @param data.range first and last second
   * @param data.now the second that is called "now", or null for a recording
   * @param data.band first and last second of the window shown, or null
   * @param data.cursor the second marked in it, or null for the band's middle
   * @param data.columns results in the range, for the size of the dots
   */
  set(data) {
    Object.assign(this.#data, data);
    if (Object.keys(data).every((name) => name === "band" || name === "cursor")) this.#request();
    else this.#renew();
  }

  #renew() {
    this.#layer = null;
    this.#request();
  }

  #request() {
    this.#frame ||= requestAnimationFrame(() => {
      this.#frame = 0;
      this.#draw();
    });
  }

  #listen() {
    const select = (event) => {
      const { left, width } = this.canvas.getBoundingClientRect();
      const part = (event.clientX - left - MARGIN.left) / (width - MARGIN.left - MARGIN.right);
      const [first, last] = this.#data.range;
      this.onSelect(first + Math.min(1, Math.max(0, part)) * (last - first));
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      select(event);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) select(event);
    });
  }

  #draw() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const plot = {
      x: MARGIN.left,
      y: MARGIN.top,
      width: width - MARGIN.left - MARGIN.right,
      height: height - MARGIN.top - MARGIN.bottom,
    };
    const [first, last] = this.#data.range;
    const toX = (t) => plot.x + ((t - first) / (last - first || 1)) * plot.width;
    const toY = (azimuth) => plot.y + ((180 - signed(azimuth)) / 360) * plot.height;
    if (!this.#layer) {
      this.#layer = document.createElement("canvas");
      const context = sized(this.#layer, width, height);
      this.#data.strip?.draw(context, plot, this.#data.share);
      this.#drawAxes(context, plot, toX, toY);
      this.#drawDots(context, plot, toX, toY);
    }
    const context = sized(this.canvas, width, height);
    context.drawImage(this.#layer, 0, 0, width, height);
    this.#drawBand(context, plot, toX);
  }

  #drawAxes(context, plot, toX, toY) {
    context.font = `12px ${getComputedStyle(this.canvas).fontFamily}`;
    context.strokeStyle = colour("line");
    context.fillStyle = colour("quiet");
    context.textBaseline = "middle";
    context.textAlign = "right";
    for (const [azimuth, side] of SIDES) {
      const y = azimuth === -180 ? plot.y + plot.height : toY(azimuth);
      stroke(context, plot.x, y, plot.x + plot.width, y);
      context.fillText(`${side}`, plot.x - 8, y - 6.5);
      context.fillText(`${wrapped(azimuth)}°`, plot.x - 8, y + 7);
    }
    context.textAlign = "center";
    for (const [t, text] of this.#timeTicks(plot.width)) {
      const x = toX(t);
      stroke(context, x, plot.y + plot.height, x, plot.y + plot.height + 4);
      context.fillText(text, x, plot.y + plot.height + 18);
    }
  }

  *#timeTicks(width) {
    const { range, now } = this.#data;
    const span = range[1] - range[0];
    const step = STEPS.find((s) => (s / span) * width >= TICK_SPACE) ?? 1200;
    if (now !== null) {
      for (let back = 0; back <= span; back += step) {
        yield [now - back, back ? `−${clock(back)}` : "now"];
      }
      return;
    }
    for (let index = Math.ceil(range[0] / step); index * step <= range[1]; index += 1) {
      yield [index * step, clock(index * step)];
    }
  }

  #drawBand(context, plot, toX) {
    const { band, cursor } = this.#data;
    if (!band) return;
    const [left, right] = band.map(toX);
    const x = cursor === null ? (left + right) / 2 : toX(cursor);
    context.fillStyle = colour("band");
    context.fillRect(left, plot.y, Math.max(right - left, 2), plot.height);
    context.strokeStyle = colour("ink");
    stroke(context, x, plot.y, x, plot.y + plot.height);
  }

  #drawDots(context, plot, toX, toY) {
    const { points, columns, now } = this.#data;
    const room = (plot.width / Math.max(columns, 1)) * 0.42;
    const most = Math.min(DOT.most, Math.max(DOT.least, room));
    const outlined = now === null && most >= OUTLINED; // live dots overlap: they make a line
    const colours = new Map([[OTHER, colour("quiet")]]);
    for (let slot = 0; slot < COUNT; slot += 1) colours.set(slot, colour(`source-${slot}`));
    context.save();
    context.strokeStyle = colour("panel");
    context.lineWidth = 1.25;
    context.beginPath();
    context.rect(plot.x - 5, plot.y - 5, plot.width + 10, plot.height + 10);
    context.clip();
    for (const { t, azimuth, confidence, slot, active = true } of points) {
      const sure = Math.min(1, Math.max(0, confidence));
      context.globalAlpha = (active ? 1 : 0.4) * (0.3 + 0.7 * sure);
      context.fillStyle = colours.get(slot);
      context.beginPath();
      context.arc(toX(t), toY(azimuth), most * (0.55 + 0.45 * sure), 0, 2 * Math.PI);
      context.fill();
      if (outlined) context.stroke();
    }
    context.restore();
  }
}

/** An azimuth in (-180, 180]. */
function signed(azimuth) {
  const positive = wrapped(azimuth);
  return positive > 180 ? positive - 360 : positive;
}

function clock(seconds) {
  if (seconds < 60) return `${Number(seconds.toFixed(1))} s`;
  return `${Math.floor(seconds / 60)}:${String(Math.round(seconds % 60)).padStart(2, "0")}`;
}

/** The context of a canvas in CSS pixels, cleared and as sharp as the screen. */
function sized(canvas, width, height) {
  const ratio = devicePixelRatio || 1;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.scale(canvas.width / width, canvas.height / height);
  return context;
}

function stroke(context, x1, y1, x2, y2) {
  context.lineWidth = 1;
  context.beginPath();
  context.moveTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
  context.lineTo(Math.round(x2) + 0.5, Math.round(y2) + 0.5);
  context.stroke();
}
