// The page: two views, what the service offers, whether it is there.

import { UNREACHED, arrays, models, ready, signpost } from "./api.js";
import { byId, showProblem } from "./dom.js";
import { listenForKeys } from "./key.js";
import { Live } from "./live.js";
import { RecordingView } from "./recording.js";

const VIEWS = ["recording", "live"];
const AGAIN_MS = 2000; // while the service loads its models, or is not there
const LOOK_MS = 5000; // while it is well

const live = new Live();
const recording = new RecordingView((setup, samples) => {
  live.replay(setup, samples);
  show("live");
  byId("live-stop").focus();
});

let waiting = true; // for the first answer of the service
let timer = 0;

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
    const asked = [signpost(), arrays(), models(), check()];
    const [{ version }, presets, bundles] = await Promise.all(asked);
    recording.setup.offer(presets, bundles);
    tell(`ready · ${version}`, "live");
    if (waiting) showProblem(byId("problem"), null);
    waiting = false;
    later(look, LOOK_MS);
  } catch (problem) {
    if (!problem.detail) throw problem;
    tell(problem.needsKey ? "key needed" : wordsFor(problem), "broken");
    if (problem.needsKey) return; // the form asks for one
    if (waiting) showProblem(byId("problem"), problem);
    later(begin, AGAIN_MS);
  }
}

/** See whether the service is still there; one that comes back may offer other things. */
async function look() {
  if (document.hidden) return later(look, LOOK_MS);
  try {
    await check();
    later(look, LOOK_MS);
  } catch (problem) {
    tell(wordsFor(problem), "broken");
    later(begin, AGAIN_MS);
  }
}

/** A Problem where the service takes no work; a proxy may hide the path that says so. */
const check = () =>
  ready().catch((problem) => {
    if (problem.status !== 404) throw problem;
  });

/** A service that was not reached, or that refuses work for now. */
const wordsFor = ({ status }) => (status ? "not ready" : "no answer");

function tell(text, state) {
  if (byId("health").textContent !== text) byId("health").textContent = text;
  byId("health").dataset.state = state;
}

function later(step, wait) {
  clearTimeout(timer);
  timer = setTimeout(step, wait);
}

listenForKeys(() => {
  begin();
  live.again();
});
addEventListener(UNREACHED, () => {
  if (waiting) return;
  tell("no answer", "broken");
  later(begin, AGAIN_MS);
});
listenToTabs();
if (location.hash === "#live") show("live");
begin();
