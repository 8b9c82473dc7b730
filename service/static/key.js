// The service's key, where it asks for one. It is kept for this tab alone, and sent as a header or,
// by a WebSocket, which can set none, as a subprotocol; never in an address.

import { byId } from "./dom.js";

const STORE = "neuralmusic.key";
const NEEDED = "key-needed";
const GIVEN = "key-given";

/** What to do about a key, by the problem's code. */
const WORDS = {
  key_missing: "Only people with a key may use it. Ask whoever runs it for one: a line of letters that begins with nm_. Paste it here.",
  key_unknown: "It does not know this key. See whether all of it was pasted, or ask whoever runs it for another.",
  key_expired: "This key is too old. Ask whoever runs the service for a new one.",
  role_missing: "This key is not for that. Ask whoever runs the service for one that is, or go on with what this one allows.",
};

let current = read();

/** Whether the user gave a key. */
export const hasKey = () => current !== "";

/** The headers of a request. */
export const authorization = () => (current ? { Authorization: `Bearer ${current}` } : {});

/** The subprotocols to offer for a stream. */
export const subprotocols = (protocol) =>
  current ? [protocol, `bearer.${base64url(current)}`] : [protocol];

/** Ask the user for a key, since the service refused with this problem. */
export const askForKey = (problem) => dispatchEvent(new CustomEvent(NEEDED, { detail: problem }));

/** Show the form when a key is needed; `onGiven` is called with every new one. */
export function listenForKeys(onGiven) {
  addEventListener(NEEDED, ({ detail: problem }) => {
    const before = byId("key-form").hidden;
    byId("key-form").hidden = false;
    byId("key-why").textContent = WORDS[problem.code] ?? problem.detail;
    if (before) byId("key").focus();
  });
  addEventListener(GIVEN, onGiven);
  byId("key-form").addEventListener("submit", (event) => {
    event.preventDefault();
    remember(byId("key").value.trim());
    byId("key").value = "";
    byId("key-form").hidden = true;
    dispatchEvent(new Event(GIVEN));
  });
}

function remember(key) {
  current = key;
  try {
    sessionStorage.setItem(STORE, key);
  } catch {
    // A browser that keeps nothing: the key lasts until the page is loaded anew.
  }
}

function read() {
  try {
    return sessionStorage.getItem(STORE) ?? "";
  } catch {
    return "";
  }
}

function base64url(text) {
  const bytes = new TextEncoder().encode(text);
  const letters = btoa(String.fromCharCode(...bytes));
  return letters.replaceAll("+", "-").replaceAll("/", "_").replace(/=+$/, "");
}
