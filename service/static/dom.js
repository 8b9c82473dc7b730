// Building elements. Text always goes through textContent: nothing that a server or a file says
// is ever read as markup.

const SVG = "http://www.w3.org/2000/svg";

/** The element of this id. */
export const byId = (id) => document.getElementById(id);

/** An HTML element; `text` is its text, every other property an attribute. */
export function element(tag, { text, ...attributes } = {}, ...children) {
  return filled(document.createElement(tag), text, attributes, children);
}

/** An SVG element, likewise. */
export function shape(tag, { text, ...attributes } = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), text, attributes, children);
}

/** Mark a field as wrong and say why, or as right again with no text. */
export function mark(input, why) {
  input.setCustomValidity(why);
  input.setAttribute("aria-invalid", String(why !== ""));
}

/** Mark a field for numbers by its own bounds. */
export function checkRange(input, unit) {
  mark(input, ""); // what was said before would count as a fault of its own
  const { min, max, validity } = input;
  mark(input, validity.valid ? "" : `This takes ${min} to ${max} ${unit}.`);
}

/** Go to the first field that is marked as wrong and say why; nothing where all are right. */
export function showWrong(form) {
  const wrong = form.querySelector('[aria-invalid="true"]');
  const fold = wrong?.closest("details");
  if (fold) fold.open = true;
  wrong?.focus();
  return wrong?.validationMessage ?? "";
}

/** Show a problem of the server, word for word, or hide it again. */
export function showProblem(box, problem) {
  box.hidden = !problem;
  if (!problem) return box.replaceChildren();
  const code = problem.code ? [element("code", { text: problem.code })] : [];
  box.replaceChildren(
    element("h2", { text: problem.title }),
    element("p", { class: "detail", text: problem.detail }),
    ...code,
  );
}

/** Terms and values, in the place of what a definition list held; empty values are left out. */
export function showFacts(list, facts) {
  const known = Object.entries(facts).filter(([, value]) => value !== null && value !== "");
  list.replaceChildren(
    ...known.map(([term, value]) =>
      element("div", {}, element("dt", { text: term }), element("dd", { text: value })),
    ),
  );
}

function filled(node, text, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) node.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) {
      node.setAttribute(name, value);
    }
  }
  if (text !== undefined) node.textContent = text;
  node.append(...children);
  return node;
}
