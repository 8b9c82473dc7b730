// Server-sent events by fetch: unlike an EventSource it sends the key, and tells a refusal.

import { ask } from "./api.js";

/** `{ type, data }` of every event until the stream ends or `signal` aborts it. */
export async function* serverEvents(path, signal) {
  const headers = { Accept: "text/event-stream" };
  const response = await ask(path, { headers, signal, cache: "no-store" });
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  try {
    let text = "";
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      text += value;
      const blocks = text.split("\n\n");
      text = blocks.pop();
      yield* blocks.map(parsed).filter(({ data }) => data !== undefined);
    }
  } finally {
    reader.cancel().catch(() => {}); // it broke off before
  }
}

/** The fields of one event; a comment has no data. */
function parsed(block) {
  const fields = {};
  for (const line of block.split("\n")) {
    const [, name, value] = /^([^:]*): ?(.*)$/.exec(line) ?? [];
    if (name === "event") fields.type = value;
    if (name === "data") fields.data = value;
  }
  return fields;
}
