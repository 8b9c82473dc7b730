// A localized recording: the window shown, azimuth over time, the summary, warnings, downloads.

import { inWords, label } from "./angles.js";
import { RecordingColours } from "./colours.js";
import { byId, element } from "./dom.js";
import { Player } from "./player.js";
import { showSources, showWarnings } from "./readout.js";
import { Sky } from "./sky.js";
import { Strip } from "./strip.js";
import { Timeline } from "./timeline.js";
import { METHODS, duration, percent } from "./words.js";

const PAGE = 10; // windows of Page Up and Page Down

export class Results {
  #windows = [];
  #index = 0;
  #links = [];

  constructor(dial) {
    this.dial = dial;
    this.sky = new Sky(byId("sky"));
    this.canvas = byId("timeline");
    this.timeline = new Timeline(this.canvas, (t) => this.#seek(t));
    this.canvas.addEventListener("keydown", (event) => this.#key(event));
    this.player = new Player(
      byId("listen"),
      (t) => this.#follow(t),
      (why) => (byId("window-note").textContent = why),
    );
    byId("listen").addEventListener("click", () => this.#listen());
  }

  /** Show an answer of POST /localize; `text` is its JSON as it came. */
  show(answer, text, file) {
    byId("answer").hidden = false;
    this.#windows = answer.windows;
    this.colours = new RecordingColours(answer);
    this.dial.setArray(answer.array.positions_m);
    this.sky.told = (answer.array.why_no_elevation ?? null) === null;
    const points = answer.windows.flatMap((window) => this.#points(window));
    this.sky.setTrail(points);
    const strong = answer.windows.reduce((best, w, i) => (score(w) > score(answer.windows[best]) ? i : best), 0);
    this.timeline.set({
      points,
      strip: Strip.of(answer.windows.map((window) => window.spectrum)),
      range: [0, answer.audio.duration_s],
      columns: answer.windows.length,
    });
    this.#select(strong);
    this.#showSummary(answer, file.name);
    showWarnings(byId("window-warnings"), byId("warnings"), answer.warnings);
    this.#offerDownloads(answer, text, file.name.replace(/\.[^.]+$/, ""));
    this.player.offer(file, answer.array.channel_map[0]);
  }

  /** Show nothing: neither arrows nor figures of a recording that is not chosen any more. */
  clear() {
    byId("answer").hidden = true;
    this.#windows = [];
    this.player.stop();
    this.dial.rest();
    this.sky.rest();
    byId("window-title").textContent = "At rest";
    byId("window-note").textContent = "Press Localize.";
    showSources(byId("window-sources"), []);
    showWarnings(byId("window-warnings"), byId("warnings"), []);
  }

  #points(window) {
    const t = (window.t_start + window.t_end) / 2;
    return window.sources.map((source) => ({
      t,
      azimuth: source.azimuth_deg,
      elevation: source.elevation_deg,
      confidence: source.confidence,
      slot: this.colours.of(source),
    }));
  }

  #nearest(t) {
    let best = 0;
    let least = Infinity;
    this.#windows.forEach(({ t_start: from, t_end: to }, index) => {
      const distance = Math.abs((from + to) / 2 - t);
      if (distance < least) [best, least] = [index, distance];
    });
    return best;
  }

  #select(index) {
    const window = this.#windows[index];
    if (!window) return;
    this.#index = index;
    const sources = window.sources.map((source) => ({
      azimuth: source.azimuth_deg,
      elevation: source.elevation_deg,
      confidence: source.confidence,
      slot: this.colours.of(source),
      id: source.id,
    }));
    const { t_start: from, t_end: to } = window;
    this.dial.show({ spectrum: window.spectrum, sources });
    this.sky.show(sources);
    this.timeline.set({ band: [from, to] });
    byId("window-title").textContent = `${from.toFixed(2)} to ${to.toFixed(2)} s`;
    byId("window-note").textContent = sources.length ? "" : "No source in this window.";
    showSources(byId("window-sources"), sources);
    const heard = sources.map(({ azimuth }) => label(azimuth)).join(", ") || "no source";
    const range = { min: 0, max: this.#windows.length - 1, now: index };
    for (const [key, value] of Object.entries(range)) {
      this.canvas.setAttribute(`aria-value${key}`, value);
    }
    this.canvas.setAttribute("aria-valuetext", `${from.toFixed(1)} to ${to.toFixed(1)} s: ${heard}`);
  }

  /** Show the window at a second that the user chose, and play on from there. */
  #seek(t) {
    this.#select(this.#nearest(t));
    if (this.player.playing) this.player.play(t);
  }

  #listen() {
    if (this.player.playing) this.player.stop();
    else if (this.#index >= this.#windows.length - 1) this.player.play(0);
    else this.player.play(this.#windows[this.#index].t_start);
  }

  /** Show what sounds; null where nothing does any more. */
  #follow(t) {
    const index = t === null ? this.#index : this.#nearest(t);
    if (index !== this.#index) this.#select(index);
    this.timeline.set({ cursor: t });
  }

  #key(event) {
    const last = this.#windows.length - 1;
    const target = {
      ArrowLeft: this.#index - 1,
      ArrowDown: this.#index - 1,
      ArrowRight: this.#index + 1,
      ArrowUp: this.#index + 1,
      PageDown: this.#index - PAGE,
      PageUp: this.#index + PAGE,
      Home: 0,
      End: last,
    }[event.key];
    if (target === undefined) return;
    event.preventDefault();
    const { t_start: from, t_end: to } = this.#windows[Math.min(last, Math.max(0, target))];
    this.#seek((from + to) / 2);
  }

  #showSummary(answer, name) {
    const heads = ["Direction", "", "Confidence", "Heard in"];
    const head = element("tr", {}, ...heads.map((text) => element("th", { scope: "col", text })));
    const rows = answer.summary.sources.map((source) =>
      element(
        "tr",
        { "data-slot": this.colours.ofSummary(source) },
        element("td", { class: "azimuth", text: label(source.azimuth_deg) }),
        element("td", { text: inWords(source.azimuth_deg, source.elevation_deg) }),
        element("td", { text: percent(source.confidence) }),
        element("td", { text: `${Math.round(source.share * 100)} %` }),
      ),
    );
    const none = element("tr", {}, element("td", { colspan: 4, text: "No source was found." }));
    byId("summary").replaceChildren(
      element("thead", {}, head),
      element("tbody", {}, ...(rows.length ? rows : [none])),
    );
    const { audio, array, model, method } = answer;
    const by = model ? `${model.name} ${model.version}` : METHODS[method];
    const heard = `“Heard in” counts the windows in which anything is heard.`;
    byId("answer-facts").textContent =
      `${name}: ${duration(audio.duration_s)} at ${audio.sample_rate / 1000} kHz, ${array.name}, by ${by}. ${heard}`;
  }

  #offerDownloads(answer, text, name) {
    this.#links.forEach((address) => URL.revokeObjectURL(address));
    this.#links = [
      ["download-json", "json", text, "application/json"],
      ["download-csv", "csv", csv(answer), "text/csv"],
    ].map(([id, ending, content, type]) => {
      const address = URL.createObjectURL(new Blob([content], { type }));
      Object.assign(byId(id), { href: address, download: `${name}.directions.${ending}` });
      return address;
    });
  }
}

/** How much a window has to show: the first one shown is the one with most. */
const score = (window) => window.sources.reduce((sum, source) => sum + source.confidence, 0);

function csv(answer) {
  const columns = ["azimuth_deg", "elevation_deg", "confidence", "id"];
  const rows = answer.windows.flatMap(({ t_start: from, t_end: to, sources }) =>
    sources.map((source) => [from, to, ...columns.map((name) => source[name] ?? "")].join(",")),
  );
  return `${[["t_start", "t_end", ...columns].join(","), ...rows].join("\n")}\n`;
}
