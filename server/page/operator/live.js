// Events as they happen, read with fetch, which can send a token where EventSource cannot.
import { request, wait } from './api.js';

const AGAIN_MS = 2000;

// Call `onEvent` with the data of each event; return at the end of the stream, throw if it breaks.
export async function readEvents(path, onEvent, { after, signal } = {}) {
  const headers = { Accept: 'text/event-stream', ...(after !== undefined && { 'Last-Event-ID': String(after) }) };
  const response = await request(path, { headers, signal });
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  let pending = '';
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const parts = (pending + value.replace(/\r/g, '')).split('\n\n');
    pending = parts.pop();
    for (const part of parts) {
      const lines = part.split('\n').filter((line) => line.startsWith('data:'));
      if (lines.length) onEvent(JSON.parse(lines.map((line) => line.slice(5)).join('\n')));
    }
  }
}

// Follow all events for as long as the page is open; `onState` is told whether they arrive.
export async function follow(path, onEvent, onState) {
  let after;
  for (;;) {
    try {
      const reading = readEvents(path, (event) => { after = event.seq; onEvent(event); }, { after });
      onState(true);
      await reading;
    } catch { /* the service is gone or refuses; the page's own requests say which */ }
    onState(false);
    await wait(AGAIN_MS);
  }
}
