// The service's HTTP interface. Addresses are relative, so that the page also works behind a
// proxy that serves it under a path.

import { askForKey, authorization } from "./key.js";

/** What the service said no to (RFC 9457), or why it could not be asked. */
export class Problem extends Error {
  constructor({ title, detail, code, status }) {
    super(detail);
    Object.assign(this, { title, detail, code, status });
  }

  /** Whether a key, or another one, would help. */
  get needsKey() {
    return this.status === 401 || this.code === "role_missing";
  }
}

const UNREACHABLE = {
  title: "The service does not answer",
  detail: "The connection failed. Is the service running, and is this device on its network?",
};

export const arrays = async () => (await getJson("arrays")).arrays;
export const models = async () => (await getJson("models")).models;
export const sessions = () => getJson("sessions");
export const signpost = () => getJson("./");
export const ready = () => getJson("readyz");

/** Post a recording with its options; the answer and its text. */
export async function localize(file, options, signal) {
  const form = new FormData();
  for (const [name, value] of Object.entries(options)) form.append(name, value);
  form.append("audio", file, file.name);
  const response = await ask("localize", { method: "POST", body: form, signal });
  const text = await response.text();
  return { answer: JSON.parse(text), text };
}

/** The stream's WebSocket address. */
export function streamAddress() {
  const address = new URL("stream", document.baseURI);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  return address.href;
}

export const eventsAddress = (id) => `sessions/${encodeURIComponent(id)}/events`;
export const exportAddress = (id, format) =>
  `sessions/${encodeURIComponent(id)}/export?format=${format}`;

async function getJson(path) {
  const headers = { Accept: "application/json" };
  return (await ask(path, { headers, cache: "no-store" })).json();
}

/** Save an answer as a file: a link could send no key. */
export async function save(path) {
  const response = await ask(path, {});
  const named = /filename="([^"]+)"/.exec(response.headers.get("Content-Disposition") ?? "");
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await response.blob());
  link.download = named?.[1] ?? "download";
  link.click();
  URL.revokeObjectURL(link.href);
}

/** Name of the event that the service was not reached. */
export const UNREACHED = "service-unreached";

/** Fetch with the key; an answer that is no success is thrown as a Problem. */
export async function ask(path, request) {
  let response;
  try {
    const headers = { ...request.headers, ...authorization() };
    response = await fetch(path, { ...request, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    dispatchEvent(new Event(UNREACHED));
    throw new Problem(UNREACHABLE);
  }
  if (response.ok) return response;
  const problem = new Problem(await readProblem(response));
  if (problem.needsKey) askForKey(problem);
  throw problem;
}

async function readProblem(response) {
  const { status } = response;
  try {
    const { title, detail, code } = await response.json();
    if (detail) return { title: title ?? "Refused", detail, code, status };
  } catch {
    // Not the service's own words: a proxy's page, or a body that broke off.
  }
  return { title: "Refused", detail: `The answer was HTTP ${status} without a reason.`, status };
}
