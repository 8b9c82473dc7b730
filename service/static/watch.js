// Watching a session that someone else runs, by server-sent events; it comes back after a break.
// Of a session that has ended the last minute is shown.

import { eventsAddress, sessions } from "./api.js";
import { serverEvents } from "./events.js";

const WAITS = [0.5, 1, 2, 4, 8]; // seconds before the next attempts

export class Watch {
  #reading = new AbortController();
  #timer = 0;
  #failures = 0;
  #over = false;

  /** Whether the session ended while it was watched. */
  left = false;

  /** `session` is an entry of GET /sessions. */
  constructor({ id, state, replica }, view) {
    this.session = id;
    this.replica = replica;
    this.view = view;
    this.ended = state === "ended";
    view.begin("Opening the session…");
    this.#open();
  }

  /** Look no more. */
  close() {
    this.#over = true;
    clearTimeout(this.#timer);
    this.#reading.abort();
  }

  #leave() {
    this.left = true;
    this.close();
  }

  async #open() {
    const { signal } = (this.#reading = new AbortController());
    try {
      for await (const { type, data } of serverEvents(eventsAddress(this.session), signal)) {
        this.#take(type, JSON.parse(data));
      }
    } catch {
      // Aborted, refused or broken off: what follows is the same.
    }
    if (!signal.aborted) this.#broken();
  }

  #take(type, message) {
    this.#failures = 0;
    this.view.receive({ ...message, type });
    if (type === "summary" || type === "error") this.#leave();
    if (type === "closing") this.#over = this.left = true; // a summary may follow; no new attempt may
  }

  #broken() {
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

  /** A session that has ended still answers with its last minute: ask first if it runs. */
  async #again() {
    try {
      const { sessions: known, replicas } = await sessions();
      if (this.#over) return;
      if (known.some(({ id, state }) => id === this.session && state === "running")) this.#open();
      else if (!replicas.includes(this.replica)) this.#broken(); // others answered
      else {
        this.#leave();
        this.view.say("The session has ended.", "ended");
      }
    } catch {
      if (!this.#over) this.#broken();
    }
  }
}
