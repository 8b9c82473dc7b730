// The live view: which sessions run, watching one of them, replaying a file as one.

import { sessions } from "./api.js";
import { byId, element } from "./dom.js";
import { LiveView } from "./live-view.js";
import { Replay, whyNotReplayable } from "./replay.js";
import { Watch } from "./watch.js";
import { METHODS, counted, duration } from "./words.js";

const POLL_MS = 2000;
const ENDED_SHOWN = 4;

export class Live {
  #stream = null;
  #timer = 0;
  #visible = false;

  constructor() {
    this.view = new LiveView();
    byId("live-stop").addEventListener("click", () => this.#stream?.stop?.());
    document.addEventListener("visibilitychange", () => this.#poll());
  }

  /** The view is shown or hidden: only then are sessions asked for. */
  setVisible(visible) {
    this.#visible = visible;
    this.#poll();
  }

  /** Ask for the sessions again, with another key. */
  again() {
    this.#poll();
  }

  /** Send the setup's file as a live stream; why not, or null. */
  replay(setup) {
    const why = whyNotReplayable(setup.header);
    if (why) return why;
    this.#leave();
    byId("live-stop").hidden = false;
    const replay = new Replay(setup, this.view, () => {
      if (this.#stream !== replay) return;
      if (document.activeElement === byId("live-stop")) byId("tab-live").focus();
      byId("live-stop").hidden = true;
    });
    this.#stream = replay;
    return null;
  }

  #watch({ id, state }) {
    if (id === this.#stream?.session && state === "running") return;
    this.#leave();
    this.#stream = new Watch(id, this.view, state === "ended");
    this.#poll();
  }

  #leave() {
    const before = this.#stream;
    this.#stream = null;
    byId("live-stop").hidden = true;
    if (before instanceof Replay) before.abandon();
    else before?.close();
  }

  async #poll() {
    clearTimeout(this.#timer);
    if (!this.#visible || document.hidden) return;
    try {
      this.#show(await sessions());
    } catch (problem) {
      byId("sessions-note").textContent = problem.detail ?? "The sessions cannot be read.";
      if (problem.needsKey) return; // until there is another
    }
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#poll(), POLL_MS);
  }

  #show({ sessions: known, max_sessions: most }) {
    const running = known.filter(({ state }) => state === "running");
    const list = byId("sessions");
    const focused = list.contains(document.activeElement) && document.activeElement.dataset.id;
    const ended = known.filter((session) => !running.includes(session)).slice(0, ENDED_SHOWN);
    list.replaceChildren(...[...running, ...ended].map((session) => this.#entry(session)));
    if (focused) list.querySelector(`[data-id="${CSS.escape(focused)}"]`)?.focus();
    const note = running.length ? `${running.length} of at most ${most}` : "No session is running.";
    if (byId("sessions-note").textContent !== note) byId("sessions-note").textContent = note;
    byId("howto").hidden = running.length > 0;
    byId("howto-command").textContent = command(byId("array").value);
  }

  #entry(session) {
    const { id, client, array, model, method, state } = session;
    const opened = array ? `${array}, ${model ?? METHODS[method]}` : "opening";
    const shown = String(id === this.#stream?.session);
    const button = element(
      "button",
      { type: "button", class: state, "data-id": id, "aria-pressed": shown },
      element("strong", { text: client ?? id }),
      element("span", { text: opened }),
      element("span", { text: course(session) }),
    );
    button.addEventListener("click", () => this.#watch(session));
    return element("li", {}, button);
  }
}

/** How a session is doing, or that it is over. */
function course({ state, audio_s: audio, lag_ms: lag, num_sources: count, started_at: begin }) {
  if (state === "ended") {
    const time = new Date(begin).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
    return `ended, ${duration(audio)} from ${time}`;
  }
  return `${duration(audio)}, ${counted(count, "source")}, lag ${Math.round(lag)} ms`;
}

/** The commands that stream a machine's microphones to this service. */
function command(array) {
  const address = new URL("./", document.baseURI).href.replace(/\/$/, "");
  const geometry = !array || array === "custom" ? "@array.json" : array;
  return [
    "neuralmusic stream --list-devices",
    `neuralmusic stream --device NAME --array ${geometry} --url ${address}`,
  ].join("\n");
}
