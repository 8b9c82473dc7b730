// Watching a session that someone else runs, by server-sent events; it comes back after a break.
// Of a session that has ended the last minute is shown.

import { eventsAddress, sessions } from "./api.js";

const TYPES = [
  "ready", "history", "result", "warning", "stats", "calibrated", "error", "closing", "summary",
];
const WAITS = [0.5, 1, 2, 4, 8]; // seconds before the next attempts

export class Watch {
  #source = null;
  #timer = 0;
  #failures = 0;
  #over = false;

  constructor(session, view, ended) {
    this.session = session;
    this.view = view;
    this.ended = ended;
    view.begin("Opening the session…");
    this.#open();
  }

  /** Look no more. */
  close() {
    this.#over = true;
    clearTimeout(this.#timer);
    this.#source?.close();
  }

  #open() {
    this.#source = new EventSource(eventsAddress(this.session));
    for (const type of TYPES) {
      this.#source.addEventListener(type, (event) => {
        if (event.data !== undefined) this.#take(type, JSON.parse(event.data));
      });
    }
    this.#source.onerror = () => this.#broken();
  }

  #take(type, message) {
    this.#failures = 0;
    this.view.receive({ ...message, type });
    if (type === "summary" || type === "error") this.close();
    if (type === "closing") this.#over = true; // a summary may follow; no new attempt may
  }

  async #broken() {
    this.#source.close();
    if (this.#over) return;
    if (this.ended) {
      this.close();
      this.view.say("This session has ended; its last minute is shown.", "ended");
      return;
    }
    const wait = WAITS[Math.min(this.#failures, WAITS.length - 1)];
    this.#failures += 1;
    this.view.say(`The connection broke. Trying again in ${wait} s…`, "broken");
    this.#timer = setTimeout(() => this.#again(), wait * 1000);
  }

  /** A session that is gone answers 404, which an EventSource does not tell: ask first. */
  async #again() {
    try {
      const { sessions: known } = await sessions();
      if (this.#over) return;
      if (known.some(({ id, state }) => id === this.session && state === "running")) this.#open();
      else {
        this.close();
        this.view.say("The session has ended.", "ended");
      }
    } catch {
      if (!this.#over) this.#broken();
    }
  }
}
