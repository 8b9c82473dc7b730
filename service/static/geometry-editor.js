// Editing microphone positions: a table in millimetres, a ring by its size, or JSON in metres.

import { element, mark } from "./dom.js";
import { whyWrong } from "./geometry.js";

const MAX_MICROPHONES = 64;
const AXES = ["x", "y", "z"];
const FORM = 'a list of [x, y, z] in metres, or {"positions_m": [...]}';

export class GeometryEditor {
  #positions = [];

  /** `onChange` is called with the positions in metres whenever they change. */
  constructor(root, onChange) {
    this.onChange = onChange;
    this.body = element("tbody");
    this.json = element("textarea", { id: "json", rows: 5, spellcheck: "false" });
    this.jsonError = element("p", { class: "error", role: "alert" });
    root.replaceChildren(
      this.#table(),
      this.#ring(),
      element(
        "details",
        {},
        element("summary", { text: "As JSON" }),
        element("label", { class: "quiet small", for: "json", text: `As files have it: ${FORM}` }),
        this.json,
        this.jsonError,
      ),
    );
    this.json.addEventListener("input", () => this.#readJson());
  }

  /** Begin with these positions. */
  begin(positions) {
    this.#positions = positions.map((p) => [...p]);
    this.#showTable();
    this.#showJson();
  }

  #table() {
    const heads = ["", ...AXES, ""].map((text) =>
      element("th", { scope: "col", text: text && `${text}, mm` }),
    );
    const add = element("button", { type: "button", class: "link", text: "Add a microphone" });
    add.addEventListener("click", () => {
      if (this.#positions.length >= MAX_MICROPHONES) return;
      this.#positions.push([0, 0, 0]);
      this.#showTable();
      this.#changed();
      this.body.lastElementChild.querySelector("input").focus();
    });
    const head = element("thead", {}, element("tr", {}, ...heads));
    return element("div", {}, element("table", {}, head, this.body), add);
  }

  #ring() {
    const [count, radius, first] = [
      { id: "ring-count", value: 6, min: 2, max: MAX_MICROPHONES },
      { id: "ring-radius", value: 46, min: 1 },
      { id: "ring-first", value: 0 },
    ].map((attributes) => element("input", { type: "number", step: "any", ...attributes }));
    const labelled = (text, input) =>
      element("label", {}, element("span", { class: "quiet", text }), input);
    const fill = element("button", { type: "button", text: "Make a ring" });
    fill.addEventListener("click", () => {
      const number = Math.floor(count.value);
      if (!(number >= 2 && number <= MAX_MICROPHONES && radius.value > 0)) return;
      this.#positions = ring(number, Number(radius.value), Number(first.value));
      this.#showTable();
      this.#changed();
    });
    return element(
      "div",
      { class: "ring-form" },
      labelled("Ring of", count),
      labelled("Radius, mm", radius),
      labelled("First at, °", first),
      fill,
    );
  }

  #showTable() {
    const rows = this.#positions.map((position, index) => this.#row(position, index));
    this.body.replaceChildren(...rows);
    this.#mark();
  }

  #mark() {
    [...this.body.rows].forEach((row, n) =>
      row.querySelectorAll("input").forEach((input, axis) =>
        mark(input, whyWrong(this.#positions, n, axis)),
      ),
    );
  }

  #row(position, index) {
    const cells = AXES.map((axis, column) => {
      const input = element("input", {
        type: "number",
        step: "any",
        value: Number((position[column] * 1000).toFixed(4)),
        "aria-label": `Microphone ${index}, ${axis} in millimetres`,
      });
      input.addEventListener("input", () => {
        position[column] = input.value === "" ? NaN : metres(Number(input.value));
        this.#changed();
      });
      return element("td", {}, input);
    });
    const label = `Remove microphone ${index}`;
    const remove = element("button", { type: "button", class: "icon", "aria-label": label, text: "×" });
    remove.addEventListener("click", () => {
      this.#positions.splice(index, 1);
      this.#showTable();
      this.#changed();
    });
    const number = element("th", { scope: "row", text: String(index) });
    return element("tr", {}, number, ...cells, element("td", {}, remove));
  }

  #changed() {
    this.#mark();
    this.#showJson();
    this.onChange(this.#positions);
  }

  #showJson() {
    this.jsonError.textContent = "";
    this.json.value = `[${this.#positions.map((p) => JSON.stringify(p)).join(",\n ")}]`;
  }

  #readJson() {
    let positions;
    try {
      const read = JSON.parse(this.json.value);
      positions = Array.isArray(read) ? read : read?.positions_m;
    } catch (error) {
      this.jsonError.textContent = `Not yet JSON: ${error.message}`;
      return;
    }
    const fits = Array.isArray(positions) && positions.every(isPosition);
    this.jsonError.textContent = fits ? "" : `Not yet positions: ${FORM}.`;
    if (!fits) return;
    this.#positions = positions.map((p) => [...p]);
    this.#showTable();
    this.onChange(this.#positions);
  }
}

/** Positions in metres evenly on a circle, counter-clockwise. */
function ring(count, radius, first) {
  return Array.from({ length: count }, (_, index) => {
    const angle = ((first + (360 * index) / count) * Math.PI) / 180;
    return [metres(radius * Math.cos(angle)), metres(radius * Math.sin(angle)), 0];
  });
}

const isPosition = (p) => Array.isArray(p) && p.length === 3 && p.every(Number.isFinite);

/** Metres of millimetres, without the noise of binary fractions. */
const metres = (mm) => Number((mm / 1000).toFixed(7));
