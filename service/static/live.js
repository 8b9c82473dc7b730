// The live view: which sessions run, watching one of them, sending a file or a microphone as one.

import { sessions } from "./api.js";
import { byId, checkRange, element, showWrong } from "./dom.js";
import { LiveView } from "./live-view.js";
import { Microphone, hasMicrophone } from "./microphone.js";
import { Replay } from "./replay.js";
import { Watch } from "./watch.js";
import { METHODS, counted, duration } from "./words.js";

const POLL_MS = 2000;
const ENDED_SHOWN = 4;

export class Live {
  #stream = null; // watched or sent
  #opened = new Set(); // ids of the sessions that were watched
  #replicas = new Set(); // that have answered
  #timer = 0;
  #visible = false;

  constructor() {
    this.view = new LiveView();
    byId("live-stop").addEventListener("click", () => this.#stream?.stop?.());
    document.addEventListener("visibilitychange", () => this.#poll());
    byId("microphone").hidden = !hasMicrophone();
    byId("spacing").addEventListener("input", ({ target }) => checkRange(target, "mm"));
    byId("listen-here").addEventListener("click", () => this.#listen());
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

  /** Send the setup's file, whose samples were opened, as a live stream. */
  replay(setup, samples) {
    this.#send((onEnd) => new Replay(setup, samples, this.view, onEnd));
  }

  #listen() {
    if (showWrong(byId("microphone"))) return byId("spacing").reportValidity();
    const spacing = Number(byId("spacing").value) / 1000;
    this.#send((onEnd) => new Microphone(spacing, this.view, onEnd));
  }

  #send(make) {
    this.#leave();
    byId("live-stop").hidden = false;
    const stream = make(() => {
      if (this.#stream !== stream) return;
      if (document.activeElement === byId("live-stop")) byId("tab-live").focus();
      byId("live-stop").hidden = true;
    });
    this.#stream = stream;
  }

  #watch(session) {
    if (session.id === this.#stream?.session && session.state === "running") return;
    this.#leave();
    this.#opened.add(session.id);
    this.#stream = new Watch(session, this.view);
    this.#poll();
  }

  #leave() {
    byId("live-stop").hidden = true;
    this.#stream?.close();
    this.#stream = null;
  }

  /** Open the only session that runs, where the user looks at no other. */
  #follow(running) {
    const [only, ...others] = running;
    const free = !this.#stream || this.#stream.left;
    if (only && !others.length && free && !this.#opened.has(only.id)) this.#watch(only);
  }

  async #poll() {
    clearTimeout(this.#timer);
    if (!this.#visible || document.hidden) return;
    try {
      this.#show(await sessions());
    } catch (problem) {
      byId("sessions").replaceChildren(); // nobody knows whether they still run
      byId("sessions-note").textContent = problem.detail ?? "The sessions cannot be read.";
      if (problem.needsKey) return; // until there is another
    }
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => this.#poll(), POLL_MS);
  }

  #show({ sessions: known, max_sessions: most, replica, replicas, unanswered }) {
    const running = known.filter(({ state }) => state === "running");
    const list = byId("sessions");
    const focused = list.contains(document.activeElement) && document.activeElement.dataset.id;
    const ended = known.filter((session) => !running.includes(session)).slice(0, ENDED_SHOWN);
    list.replaceChildren(...[...running, ...ended].map((session) => this.#entry(session)));
    if (focused) list.querySelector(`[data-id="${CSS.escape(focused)}"]`)?.focus();
    const count = running.length ? `${running.length} of at most ${most}` : "No session is running";
    const note = `${count}${this.#where({ replica, replicas, unanswered })}.`;
    if (byId("sessions-note").textContent !== note) byId("sessions-note").textContent = note;
    byId("howto").hidden = running.length > 0;
    byId("howto-command").textContent = command(byId("array").value);
    this.#follow(running);
  }

  /** The replicas that the list speaks of, where there are several. */
  #where({ replica, replicas, unanswered }) {
    this.#replicas.add(replica);
    const missing = unanswered ? `; ${counted(unanswered, "replica")} did not answer` : "";
    if (replicas.length > 1 || unanswered) return ` on ${counted(replicas.length, "replica")}${missing}`;
    // Others answer in turn, and each knows its own sessions only.
    return this.#replicas.size > 1 ? ` on the replica ${replica}, one of several` : "";
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
