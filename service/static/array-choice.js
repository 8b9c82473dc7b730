// The microphone array: a preset or positions of one's own, and which channel is which microphone.

import { arrayPlots } from "./array-plot.js";
import { byId, element, mark, showFacts } from "./dom.js";
import { GeometryEditor } from "./geometry-editor.js";
import { facts, hints } from "./geometry.js";
import { counted } from "./words.js";

const CUSTOM = "custom";
const DEFAULT = "respeaker-usb-4mic-v2";
const STORE = "neuralmusic.array";

export class ArrayChoice {
  #presets = [];
  #custom = [];
  #channels = null;

  /** `onChange` is called whenever the array is another one. */
  constructor(onChange) {
    this.onChange = onChange;
    this.select = byId("array");
    this.map = byId("channel-map");
    this.editor = new GeometryEditor(byId("editor"), (positions) => this.#edited(positions));
    this.select.addEventListener("change", () => this.#chosen());
    this.map.addEventListener("input", () => this.#note());
    byId("edit-array").addEventListener("click", () => {
      this.#custom = this.positions.map((p) => [...p]);
      this.select.value = CUSTOM;
      this.#chosen();
      byId("editor").querySelector("input").focus();
    });
  }

  /** Offer these presets; the last choice of this browser is made again. */
  offer(presets) {
    const map = this.channelMap; // of a page that waited for the service to come back
    this.#presets = presets;
    const kept = recall();
    this.#custom = kept?.positions ?? presets[0].positions_m;
    this.#fill(kept?.name ?? DEFAULT);
    this.#chosen();
    if (map) this.map.value = map;
    this.#note();
  }

  /** The recording has so many channels; null where this is not known. */
  setChannels(channels) {
    this.#channels = channels;
    this.#fill(this.select.value);
    this.#propose();
  }

  get isCustom() {
    return this.select.value === CUSTOM;
  }

  get #preset() {
    return this.#presets.find((preset) => preset.name === this.select.value);
  }

  /** Metres, [x, y, z] per microphone. */
  get positions() {
    return (this.isCustom ? this.#custom : this.#preset?.positions_m) ?? [];
  }

  /** The option `array` of POST /localize. */
  get option() {
    return this.isCustom ? JSON.stringify(this.message) : this.select.value;
  }

  /** The field `array` of the stream's `start`. */
  get message() {
    return this.isCustom
      ? { name: CUSTOM, positions_m: this.#custom }
      : { name: this.select.value };
  }

  /** The channel map as it is written; empty where the channels are the microphones. */
  get channelMap() {
    return this.map.value.trim();
  }

  #fill(chosen) {
    const fitting = this.#presets.filter((preset) => fits(preset, this.#channels));
    const others = this.#presets.filter((preset) => !fitting.includes(preset));
    const groups = [];
    if (this.#channels && fitting.length) {
      const label = `Fit a recording of ${counted(this.#channels, "channel")}`;
      groups.push(element("optgroup", { label }, ...fitting.map(presetOption)));
      groups.push(element("optgroup", { label: "Others" }, ...others.map(presetOption)));
    } else groups.push(...this.#presets.map(presetOption));
    const custom = element("option", { value: CUSTOM, text: "Custom positions" });
    this.select.replaceChildren(...groups, custom);
    this.select.value = chosen;
    if (!this.select.value) this.select.value = this.#presets[0].name;
  }

  #chosen() {
    byId("editor").hidden = !this.isCustom;
    byId("edit-array").hidden = this.isCustom;
    this.editor.begin(this.isCustom ? this.#custom : []);
    byId("array-origin").hidden = this.isCustom;
    byId("array-source").textContent = this.#preset?.source ?? "";
    this.#propose();
    this.#show();
  }

  #edited(positions) {
    this.#custom = positions.map((p) => [...p]);
    this.#note();
    this.#show();
  }

  #show() {
    const { positions } = this;
    const drawable = positions.length && positions.every((p) => p.every(Number.isFinite));
    byId("array-plot").replaceChildren(...(drawable ? arrayPlots(positions) : []));
    showFacts(byId("array-facts"), drawable ? facts(positions) : {});
    const found = hints(positions).map((text) => element("li", { text }));
    byId("array-hints").replaceChildren(...found);
    remember({ name: this.select.value, positions: this.#custom });
    this.onChange();
  }

  #propose() {
    const channels = this.#channels;
    const known = channels && this.#preset?.raw_channels[channels];
    this.map.value = known ? known.join(",") : "";
    this.#note();
  }

  #note() {
    const wrong = this.#wrongMap();
    mark(this.map, wrong);
    byId("channel-note").textContent = wrong || this.#sentence();
    this.onChange();
  }

  /** What is wrong with the channel map, or nothing. */
  #wrongMap() {
    const [map, channels, count] = [this.channelMap, this.#channels, this.positions.length];
    if (!map) return "";
    if (!/^\[?\s*\d+(\s*,\s*\d+)*\s*\]?$/.test(map)) {
      return "Write the channel of every microphone, counted from 0, with commas: 0,1,2.";
    }
    const chosen = map.match(/\d+/g).map(Number);
    if (count && chosen.length !== count) {
      return `The map has ${counted(chosen.length, "channel")}, the array ${counted(count, "microphone")}.`;
    }
    const beyond = channels && chosen.find((channel) => channel >= channels);
    return beyond ? `There is no channel ${beyond}: the recording has 0 to ${channels - 1}.` : "";
  }

  #sentence() {
    const [channels, count] = [this.#channels, this.positions.length];
    if (!channels) return "";
    const known = this.#preset?.raw_channels[channels];
    if (known && this.channelMap === known.join(",")) {
      return `Proposed: in this device's recordings of ${channels} channels the raw microphones are ${known.join(", ")}.`;
    }
    if (this.channelMap || channels === count) return "";
    if (channels > count) {
      return `The recording has ${channels} channels, the array ${count} microphones: write the channel of every microphone, counted from 0, as in 0,1,2.`;
    }
    return `The recording has ${counted(channels, "channel")}, the array ${count} microphones: is it another array?`;
  }
}

const presetOption = ({ name, num_microphones: count }) =>
  element("option", { value: name, text: `${name} (${count} mics)` });

const fits = (preset, channels) =>
  preset.num_microphones === channels || String(channels) in preset.raw_channels;

function recall() {
  try {
    return JSON.parse(localStorage.getItem(STORE));
  } catch {
    return null; // storage is switched off, or holds something else
  }
}

function remember(choice) {
  try {
    localStorage.setItem(STORE, JSON.stringify(choice));
  } catch {
    // A private window: the choice lasts as long as the page.
  }
}
