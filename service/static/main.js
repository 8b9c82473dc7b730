// The page: two views, what the service offers, whether it is there.

import { arrays, models, signpost } from "./api.js";
import { byId, showProblem } from "./dom.js";
import { listenForKeys } from "./key.js";
import { Live } from "./live.js";
import { RecordingView } from "./recording.js";

const VIEWS = ["recording", "live"];
const AGAIN_MS = 2000; // while the service loads its models, or is not there yet

const live = new Live();
const recording = new RecordingView((setup) => {
  const why = live.replay(setup);
  byId("setup-status").textContent = why ?? "";
  if (why) return;
  show("live");
  byId("live-stop").focus();
});

function show(chosen) {
  for (const name of VIEWS) {
    const tab = byId(`tab-${name}`);
    tab.setAttribute("aria-selected", String(name === chosen));
    tab.tabIndex = name === chosen ? 0 : -1;
    byId(name).hidden = name !== chosen;
  }
  live.setVisible(chosen === "live");
  if (location.hash !== `#${chosen}`) history.replaceState(null, "", `#${chosen}`);
}

function listenToTabs() {
  for (const name of VIEWS) byId(`tab-${name}`).addEventListener("click", () => show(name));
  document.querySelector("[role=tablist]").addEventListener("keydown", (event) => {
    if (!["ArrowLeft", "ArrowRight"].includes(event.key)) return;
    const other = VIEWS.find((name) => byId(name).hidden);
    show(other);
    byId(`tab-${other}`).focus();
  });
  addEventListener("drop", () => show("recording"));
  byId("howto-replay").addEventListener("click", () => {
    show("recording");
    byId("file").focus();
  });
}

async function begin() {
  try {
    const [{ version }, presets, bundles] = await Promise.all([signpost(), arrays(), models()]);
    recording.setup.offer(presets, bundles);
    byId("health").textContent = `ready · ${version}`;
    byId("health").dataset.state = "live";
    showProblem(byId("problem"), null);
  } catch (problem) {
    if (!problem.detail) throw problem;
    byId("health").textContent = problem.needsKey ? "key needed" : "not ready";
    byId("health").dataset.state = "broken";
    if (problem.needsKey) return; // the form asks for one
    showProblem(byId("problem"), problem);
    setTimeout(begin, AGAIN_MS);
  }
}

listenForKeys(() => {
  begin();
  live.again();
});
listenToTabs();
if (location.hash === "#live") show("live");
begin();
