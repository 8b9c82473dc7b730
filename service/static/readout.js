// The sources of one moment as a list: azimuth, where that is in words, how sure; and warnings.

import { inWords, label } from "./angles.js";
import { element } from "./dom.js";
import { isSerious, percent, warningTitle } from "./words.js";

/** Fill a list with sources as the dial takes them. */
export function showSources(list, sources) {
  list.replaceChildren(...sources.map(entry));
}

/** Fill a list with the serious ones of `{ code, detail, count }`, and the other with the rest. */
export function showWarnings(serious, others, warnings) {
  serious.replaceChildren(...warnings.filter(({ code }) => isSerious(code)).map(warning));
  others.replaceChildren(...warnings.filter(({ code }) => !isSerious(code)).map(warning));
  others.closest("section").hidden = !others.children.length;
}

function warning({ code, detail, count = 1 }) {
  const times = count > 1 ? ` (${count} times)` : "";
  return element(
    "li",
    {},
    element("strong", { text: warningTitle(code) + times }),
    element("span", { text: detail }),
  );
}

function entry({ azimuth, elevation = null, confidence, slot, id, active = true }) {
  const known = (id ?? null) !== null;
  const where = inWords(azimuth, elevation) + (active ? "" : ", pausing");
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
    element("span", { class: "sure", text: `${percent(confidence)} sure` }),
    element("meter", { min: 0, max: 1, value: confidence, "aria-hidden": "true" }),
  );
}
