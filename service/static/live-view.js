// One stream as it is heard: the dial, the last minute, lag, warnings. It draws the newest result
// once per frame of the screen, so that it never falls behind.

import { TrackColours } from "./colours.js";
import { Dial } from "./dial.js";
import { byId, element, showFacts, showProblem } from "./dom.js";
import { exportAddress, save } from "./api.js";
import { hasKey } from "./key.js";
import { showSources, showWarnings } from "./readout.js";
import { Sky } from "./sky.js";
import { Strip } from "./strip.js";
import { Timeline } from "./timeline.js";
import { METHODS, duration, whyNoSource } from "./words.js";

const HISTORY = 60; // seconds
const SHORTEST = 15; // seconds that are shown at least: a young session fills them sooner
const DOTS_PER_S = 5; // that the size of the dots leaves room for; closer ones make a line
const MAX_WARNINGS = 8;
const TRAIL = 10; // seconds that the sky shows

export class LiveView {
  #frame = 0;

  constructor() {
    this.dial = new Dial(byId("live-dial"));
    this.sky = new Sky(byId("live-sky"));
    this.timeline = new Timeline(byId("live-timeline"));
    this.#reset();
  }

  /** Begin with an empty view. */
  begin(text) {
    this.#reset();
    this.say(text, "waiting");
  }

  /** Say how the connection is: "waiting", "live", "ended" or "broken". */
  say(text, state) {
    const line = byId("live-state");
    if (line.textContent !== text) line.textContent = text;
    line.dataset.state = state;
    byId("live").dataset.state = state; // what was last heard is no direction of the present
    this.#showTitle();
  }

  #showTitle() {
    const { state } = byId("live").dataset;
    const word = state === "ended" || state === "broken" ? "Last heard" : "Now";
    const at = this.latest ? `, ${duration(this.latest.result.t_end)}` : "";
    byId("live-title").textContent = word + at;
  }

  /** Show why a stream was refused or broke off. */
  fail(problem) {
    showProblem(byId("live-problem"), problem);
    this.say("The stream has ended with a problem.", "broken");
  }

  /** Take a message of the stream or of its events. */
  receive(message) {
    const take = {
      ready: () => this.#ready(message),
      history: () => this.#history(message.points),
      result: () => this.#result(message),
      warning: () => this.#warning(message),
      stats: () => this.#stats(message),
      calibrated: () => this.say(`Learnt ${message.seconds} s of noise.`, "live"),
      error: () => this.fail(message),
      closing: () => this.#closing(message),
      summary: () => this.#summary(message),
    }[message.type];
    take?.();
  }

  #reset() {
    this.points = [];
    this.warnings = new Map();
    this.summed = false;
    this.facts = {};
    this.latest = null;
    this.colours = new TrackColours();
    this.interval = 0.1;
    this.strip = new Strip(HISTORY / this.interval);
    this.dial.rest();
    this.sky.rest();
    this.timeline.set(this.#minute(0));
    showProblem(byId("live-problem"), null);
    byId("live-note").textContent = "";
    byId("live-exports").replaceChildren();
    showSources(byId("live-sources"), []);
    showFacts(byId("live-facts"), {});
    this.#showWarnings();
  }

  #ready({ session, model, method, array, timing }) {
    this.interval = timing.interval_ms / 1000;
    this.strip = new Strip(HISTORY / this.interval);
    this.dial.setArray(array.positions_m);
    this.sky.told = (array.why_no_elevation ?? null) === null;
    this.facts = {
      Array: array.name,
      Method: model ? `${model.name} ${model.version}` : METHODS[method],
      Window: `${Math.round(timing.window_ms)} ms every ${timing.interval_ms} ms`,
      Lag: null,
    };
    showFacts(byId("live-facts"), this.facts);
    byId("live-exports").replaceChildren(
      ...["csv", "jsonl"].map((format) =>
        this.#export(exportAddress(session, format), format.toUpperCase()),
      ),
    );
    this.say("Listening.", "live");
  }

  #export(href, text) {
    const link = element("a", { href, download: true, text });
    link.addEventListener("click", (event) => {
      if (!hasKey()) return;
      event.preventDefault();
      save(href).catch((problem) => showProblem(byId("live-problem"), problem));
    });
    return link;
  }

  #history(points) {
    this.points = points.map(([t, azimuth, id, confidence, active, elevation]) => ({
      t,
      azimuth,
      elevation,
      confidence,
      active,
      slot: this.colours.of(id),
    }));
    const last = this.points.at(-1);
    if (!last) return;
    this.timeline.set(this.#minute(last.t));
    this.#showTrail(last.t);
  }

  #result(result) {
    const sources = result.sources.map((source) => ({
      ...source,
      azimuth: source.azimuth_deg,
      elevation: source.elevation_deg,
      slot: this.colours.of(source.id),
    }));
    for (const { azimuth, elevation, confidence, active, slot } of sources) {
      this.points.push({ t: result.t_end, azimuth, elevation, confidence, active, slot });
    }
    // Here, not where it is drawn: a hidden page draws nothing, but goes on hearing.
    const old = this.points.findIndex(({ t }) => t > result.t_end - HISTORY);
    if (old > 0) this.points.splice(0, old);
    const passed = this.latest ? result.t_end - this.latest.result.t_end : this.interval;
    this.strip.push(result.spectrum, Math.round(passed / this.interval));
    this.latest = { result, sources };
    this.#frame ||= requestAnimationFrame(() => this.#draw());
  }

  #draw() {
    this.#frame = 0;
    if (!this.latest) return;
    const { result, sources } = this.latest;
    this.dial.show({ spectrum: result.spectrum, sources });
    this.sky.show(sources);
    this.#showTrail(result.t_end);
    this.timeline.set(this.#minute(result.t_end));
    this.#showTitle();
    byId("live-note").textContent = sources.length ? "" : whyNoSource(result.why_no_source);
    showSources(byId("live-sources"), sources);
    this.facts.Lag = `${Math.round(result.lag_ms)} ms`;
    showFacts(byId("live-facts"), this.facts);
  }

  #showTrail(now) {
    this.sky.setTrail(this.points.filter(({ t }) => t > now - TRAIL));
  }

  #minute(now) {
    const { points, strip } = this;
    const span = Math.min(HISTORY, Math.max(SHORTEST, now));
    const columns = span * DOTS_PER_S;
    return { points, strip, now, columns, share: span / HISTORY, range: [now - span, now] };
  }

  #stats({ audio_s: audio, results, dropped_s: dropped, gap_s: gap, results_dropped: skipped }) {
    Object.assign(this.facts, {
      Heard: `${duration(audio)}, ${results} results`,
      Dropped: dropped > 0 ? duration(dropped) : null,
      Missing: gap > 0 ? duration(gap) : null,
      Skipped: skipped > 0 ? `${skipped} results` : null,
    });
    showFacts(byId("live-facts"), this.facts);
  }

  #warning({ code, detail }) {
    const count = (this.warnings.get(code)?.count ?? 0) + 1;
    this.warnings.delete(code); // the newest comes last
    this.warnings.set(code, { code, detail, count });
    this.#showWarnings();
  }

  #showWarnings() {
    const newest = [...this.warnings.values()].reverse().slice(0, MAX_WARNINGS);
    showWarnings(byId("live-serious"), byId("live-warnings"), newest);
  }

  #closing({ detail }) {
    if (!this.summed) this.say(`The session has ended: ${detail}`, "ended");
  }

  #summary({ audio_s: audio, results, dropped_s: dropped }) {
    this.summed = true;
    const lost = dropped > 0 ? `, ${duration(dropped)} dropped` : "";
    this.say(`The session has ended after ${duration(audio)}: ${results} results${lost}.`, "ended");
  }
}
