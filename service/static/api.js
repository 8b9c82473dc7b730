// The service's HTTP interface. Addresses are relative, so that the page also works behind a
// proxy that serves it under a path.

/** What the service said no to (RFC 9457), or why it could not be asked. */
export class Problem extends Error {
  constructor({ title, detail, code, status }) {
    super(detail);
    Object.assign(this, { title, detail, code, status });
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

async function ask(path, request) {
  let response;
  try {
    response = await fetch(path, request);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(UNREACHABLE);
  }
  if (response.ok) return response;
  throw new Problem(await readProblem(response));
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
