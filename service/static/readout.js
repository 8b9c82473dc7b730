// The sources of one moment as a list: azimuth, where that is in words, how sure.

import { inWords, label } from "./angles.js";
import { element } from "./dom.js";

/** Fill a list with sources as the dial takes them. */
export function showSources(list, sources) {
  list.replaceChildren(...sources.map(entry));
}

function entry({ azimuth, confidence, slot, id, active = true }) {
  const known = (id ?? null) !== null;
  const where = active ? inWords(azimuth) : `${inWords(azimuth)}, pausing`;
  const sure = Math.round(confidence * 100);
  return element(
    "li",
    { "data-slot": slot, "data-azimuth": azimuth, "data-id": known ? id : null, class: active ? "" : "coasting" },
    element("span", { class: "azimuth", text: label(azimuth) }),
    element(
      "span",
      { class: "where" },
      element("span", { text: where }),
      ...(known ? [element("span", { class: "id", text: `#${id}` })] : []),
    ),
    element("span", { class: "sure", text: `${sure} % sure` }),
    element("meter", { min: 0, max: 100, value: sure, "aria-hidden": "true" }),
  );
}
