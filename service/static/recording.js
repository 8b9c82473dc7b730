// The view of a recording: post it, show the answer or what is wrong.

import { localize } from "./api.js";
import { byId, showProblem } from "./dom.js";
import { Dial } from "./dial.js";
import { Results } from "./results.js";
import { Setup } from "./setup.js";
import { counted } from "./words.js";

export class RecordingView {
  #running = null;
  #answered = false;

  /** `onReplay` is called with the setup when the user wants the file as a live stream. */
  constructor(onReplay) {
    this.dial = new Dial(byId("dial"));
    this.results = new Results(this.dial);
    this.button = byId("localize");
    this.setup = new Setup({ onChange: () => this.#changed(), onSample: () => this.#run() });
    byId("setup").addEventListener("submit", (event) => {
      event.preventDefault();
      if (this.#running) this.#running.abort();
      else this.#run();
    });
    byId("replay").addEventListener("click", () => onReplay(this.setup));
  }

  #changed() {
    const { file, array } = this.setup;
    this.button.disabled = !this.#running && !file;
    byId("replay").disabled = !file;
    const { positions } = array;
    const drawable = positions.length > 1 && positions.every((p) => p.every(Number.isFinite));
    if (!this.#answered && drawable) this.dial.setArray(positions);
  }

  async #run() {
    const { file, options } = this.setup;
    if (!file) return;
    this.#running = new AbortController();
    this.button.textContent = "Cancel";
    showProblem(byId("problem"), null);
    say(`Localizing ${file.name}…`);
    try {
      const { answer, text } = await localize(file, options, this.#running.signal);
      this.#answered = true;
      this.results.show(answer, text, file);
      const count = answer.summary.sources.length;
      say(`Found ${counted(count, "direction")} in ${counted(answer.windows.length, "window")}.`);
      bringIntoView();
    } catch (error) {
      if (error.name === "AbortError") say("Cancelled.");
      else if (error.detail) {
        say("");
        showProblem(byId("problem"), error);
        byId("problem").scrollIntoView({ block: "nearest" });
      } else throw error;
    } finally {
      this.#running = null;
      this.button.textContent = "Localize";
      this.#changed();
    }
  }
}

function say(text) {
  byId("setup-status").textContent = text;
}

/** On a narrow screen the answer is below what was filled in. */
function bringIntoView() {
  const { top } = byId("dial").getBoundingClientRect();
  if (top < innerHeight * 0.6) return;
  const behavior = matchMedia("(prefers-reduced-motion: reduce)").matches ? "auto" : "smooth";
  byId("dial").scrollIntoView({ behavior, block: "start" });
}
