// The view of a recording: post it, show the answer or what is wrong.

import { localize } from "./api.js";
import { byId, showProblem, showWrong } from "./dom.js";
import { Dial } from "./dial.js";
import { Results } from "./results.js";
import { Unreadable, openSamples } from "./samples.js";
import { Setup } from "./setup.js";
import { counted } from "./words.js";

export class RecordingView {
  #running = null;
  /** What the answer or the problem shown was asked for: the file, and the options as JSON. */
  #asked = null;

  /** `onReplay` gets the setup and the file's samples when the user wants it as a live stream. */
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
    byId("replay").addEventListener("click", () => this.#replay(onReplay));
  }

  async #replay(onReplay) {
    const { file, header } = this.setup;
    const wrong = showWrong(byId("setup"));
    if (wrong) return say(wrong);
    say(`Reading ${file.name}…`);
    try {
      const samples = await openSamples(file, header);
      say("");
      if (this.setup.file === file) onReplay(this.setup, samples);
    } catch (error) {
      if (!(error instanceof Unreadable)) throw error;
      say(error.message);
    }
  }

  #changed() {
    const { file, array } = this.setup;
    this.button.disabled = !this.#running && !file;
    byId("replay").disabled = !file;
    const { positions } = array;
    const drawable = positions.length > 1 && positions.every((p) => p.every(Number.isFinite));
    this.#compare();
    if (!this.#asked && drawable) this.dial.setArray(positions);
  }

  /** What is shown belongs to what is chosen: else it goes, or is dimmed where one may go back. */
  #compare() {
    if (this.#running) return;
    if (!this.#asked) return this.#dim(false);
    const { file, options } = this.setup;
    const same = this.#asked.options === JSON.stringify(options);
    if (this.#asked.file !== file || !(same || this.#asked.answered)) return this.#clear();
    this.#dim(!same);
    if (!same) say("");
  }

  #clear() {
    this.#asked = null;
    this.results.clear();
    showProblem(byId("problem"), null);
    this.#dim(false);
    say("");
  }

  #dim(stale) {
    byId("recording").classList.toggle("stale", stale);
    byId("stale").hidden = !stale;
  }

  async #run() {
    const { file, options } = this.setup;
    if (!file) return;
    const wrong = showWrong(byId("setup"));
    if (wrong) return say(wrong);
    const asked = { file, options: JSON.stringify(options) };
    this.#running = new AbortController();
    this.button.textContent = "Cancel";
    if (!this.#asked?.answered) this.#clear();
    byId("recording").classList.add("stale");
    say(`Localizing ${file.name}…`);
    try {
      const { answer, text } = await localize(file, options, this.#running.signal);
      this.#asked = { ...asked, answered: true };
      this.results.show(answer, text, file);
      const count = answer.summary.sources.length;
      say(`Found ${counted(count, "direction")} in ${counted(answer.windows.length, "window")}.`);
      bringIntoView();
    } catch (error) {
      if (error.name === "AbortError") say("Cancelled.");
      else if (error.detail) {
        this.#clear();
        this.#asked = asked;
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
