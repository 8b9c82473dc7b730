// What is to be localized and how: the file, the array, the method.

import { sampleFile } from "./sample.js";
import { ArrayChoice } from "./array-choice.js";
import { readHeader } from "./audio-file.js";
import { byId, checkRange, element } from "./dom.js";
import { METHODS, capital, counted, duration } from "./words.js";

const MAX_SOURCES = 4;
const CLASSICAL = ["norm_music", "music", "srp_phat", "gcc_phat"];

export class Setup {
  file = null;
  /** Of the file, as `readHeader` gives it. */
  header = null;
  #models = [];

  /** `onChange` is called when anything changed, `onSample` when the sample was chosen. */
  constructor({ onChange, onSample }) {
    this.onChange = onChange;
    this.array = new ArrayChoice(() => onChange());
    const estimate = element("option", { value: "", text: "count them" });
    const counts = Array.from({ length: MAX_SOURCES }, (_, i) => String(i + 1));
    const options = counts.map((n) => element("option", { value: n, text: n }));
    byId("num-sources").replaceChildren(estimate, ...options);
    byId("num-sources").addEventListener("change", onChange);
    byId("hemisphere").addEventListener("change", onChange);
    byId("method").addEventListener("change", () => {
      this.#describeMethod();
      onChange();
    });
    for (const id of ["window-s", "hop-s"]) {
      byId(id).addEventListener("input", (event) => {
        checkRange(event.target, "seconds");
        onChange();
      });
    }
    byId("file").addEventListener("change", (event) => this.take(event.target.files[0]));
    byId("sample").addEventListener("click", async () => {
      const { positions } = this.array;
      if (positions.length < 2) return;
      await this.take(sampleFile(positions));
      onSample();
    });
    this.#takeDrops(byId("drop"));
  }

  /** Offer what the service has; what is chosen stays chosen. */
  offer(presets, models) {
    const chosen = byId("method").value;
    const option = (value, text) => element("option", { value, text });
    const neural = ({ name, version }) => option(`model:${name}`, `${name} ${version}`);
    const use = models.filter(({ purpose }) => purpose === "localization");
    const compare = models.filter((model) => !use.includes(model));
    byId("method").replaceChildren(
      option("", "Automatic: the best for the array"),
      ...use.map(neural),
      element(
        "optgroup",
        { label: "To compare with" },
        ...CLASSICAL.map((method) => option(`method:${method}`, capital(METHODS[method]))),
        ...compare.map(neural),
      ),
    );
    byId("method").value = chosen;
    if (!byId("method").value) byId("method").value = "";
    this.#models = models;
    this.#describeMethod();
    this.array.offer(presets);
  }

  #describeMethod() {
    const [, name] = byId("method").value.split(":");
    byId("method-note").textContent =
      this.#models.find((model) => model.name === name)?.description ?? "";
  }

  /** Take a file, whatever it is: the service says what is wrong with it. */
  async take(file) {
    if (!file) return;
    this.file = file;
    this.header = await readHeader(file);
    byId("file-name").textContent = file.name;
    byId("file-facts").textContent = this.#describe();
    byId("drop").classList.add("full");
    this.array.setChannels(this.header.channels ?? null);
    this.onChange();
  }

  /** The model and method chosen, each only where one was. */
  get method() {
    const [kind, name] = byId("method").value.split(":");
    return name ? { [kind]: name } : {};
  }

  get numSources() {
    return Number(byId("num-sources").value) || null;
  }

  /** The side on which all sources are, only where one was chosen. */
  get hemisphere() {
    const { value } = byId("hemisphere");
    return value ? { hemisphere: value } : {};
  }

  /** The options of POST /localize. */
  get options() {
    const options = { array: this.array.option, spectrum: "true", ...this.method };
    const given = {
      channel_map: this.array.channelMap,
      num_sources: byId("num-sources").value,
      hemisphere: byId("hemisphere").value,
      window_s: byId("window-s").value,
      hop_s: byId("hop-s").value,
    };
    for (const [name, value] of Object.entries(given)) if (value) options[name] = value;
    return options;
  }

  #describe() {
    const { kind, channels, sampleRate, seconds } = this.header;
    const known = [
      kind?.toUpperCase(),
      channels && counted(channels, "channel"),
      sampleRate && `${sampleRate / 1000} kHz`,
      seconds && duration(seconds),
      `${(this.file.size / 2 ** 20).toFixed(1)} MB`,
    ];
    return known.filter(Boolean).join(" · ");
  }

  #takeDrops(zone) {
    // The whole window takes files: one that misses the zone would otherwise replace the page.
    addEventListener("dragover", (event) => {
      event.preventDefault();
      zone.classList.add("over");
    });
    addEventListener("dragleave", (event) => {
      if (!event.relatedTarget) zone.classList.remove("over");
    });
    addEventListener("drop", (event) => {
      event.preventDefault();
      zone.classList.remove("over");
      this.take(event.dataTransfer.files[0]);
    });
  }
}
