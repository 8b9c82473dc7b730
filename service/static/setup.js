// What is to be localized and how: the file, the array, the method.

import { sampleFile } from "./sample.js";
import { ArrayChoice } from "./array-choice.js";
import { readHeader } from "./audio-file.js";
import { byId, element } from "./dom.js";
import { METHODS, counted, duration } from "./words.js";

const MAX_SOURCES = 4;
const CLASSICAL = ["norm_music", "music", "srp_phat"];

export class Setup {
  file = null;
  /** Of the file, as `readHeader` gives it. */
  header = null;

  /** `onChange` is called when anything changed, `onSample` when the sample was chosen. */
  constructor({ onChange, onSample }) {
    this.onChange = onChange;
    this.array = new ArrayChoice(() => onChange());
    const estimate = element("option", { value: "", text: "count them" });
    const counts = Array.from({ length: MAX_SOURCES }, (_, i) => String(i + 1));
    const options = counts.map((n) => element("option", { value: n, text: n }));
    byId("num-sources").replaceChildren(estimate, ...options);
    byId("file").addEventListener("change", (event) => this.take(event.target.files[0]));
    byId("sample").addEventListener("click", async () => {
      const { positions } = this.array;
      if (positions.length < 2) return;
      await this.take(sampleFile(positions));
      onSample();
    });
    this.#takeDrops(byId("drop"));
  }

  /** Offer what the service has. */
  offer(presets, models) {
    const automatic = element("option", { value: "", text: "Automatic" });
    const neural = models.map(({ name, version }) =>
      element("option", { value: `model:${name}`, text: `Neural: ${name} ${version}` }),
    );
    const classical = CLASSICAL.map((method) =>
      element("option", { value: `method:${method}`, text: `Classical: ${METHODS[method]}` }),
    );
    byId("method").replaceChildren(automatic, ...neural, ...classical);
    this.array.offer(presets);
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

  /** The options of POST /localize. */
  get options() {
    const options = { array: this.array.option, spectrum: "true", ...this.method };
    const given = {
      channel_map: this.array.channelMap,
      num_sources: byId("num-sources").value,
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
