// Requests of the page to the service, with the token that a person entered; this browser keeps it for all its tabs.
const KEY = 'spike4dgs-token';
const AGAIN_MS = 2000; // between looks for events
const MOST_KEPT = 200; // pictures fetched with a token
const fetched = new Map(); // path to promise of a blob's address

export const token = () => localStorage.getItem(KEY);
export const setToken = (text) => localStorage.setItem(KEY, text);

const refused = (status, detail) => Object.assign(new Error(detail), { status });

export async function request(path, { method = 'GET', body, headers, signal } = {}) {
  const raw = body instanceof Blob;
  const all = { ...headers, ...(body !== undefined && !raw && { 'Content-Type': 'application/json' }), ...(token() && { Authorization: `Bearer ${token()}` }) };
  const response = await fetch(path, { method, headers: all, signal, body: raw ? body : JSON.stringify(body) }).catch((error) => {
    throw error.name === 'AbortError' ? error : refused(0, 'The service does not answer; check that it runs');
  });
  if (response.status === 401) document.dispatchEvent(new CustomEvent('token-wanted'));
  if (response.ok) return response;
  const { detail } = await response.json().catch(() => ({}));
  throw refused(response.status, detail ?? `${response.status} ${response.statusText}`);
}

export const get = async (path) => (await request(`/v1${path}`)).json();

// The address of a rig: its name may have characters that mean something in addresses.
export const rigPath = (id) => `/rigs/${encodeURIComponent(id)}`;

export async function send(method, path, body, headers) {
  const response = await request(`/v1${path}`, { method, body, headers });
  return response.status === 204 ? null : response.json();
}

// One key a click, so that a request sent twice is done once.
const newKey = () => crypto.getRandomValues(new BigUint64Array(2)).join('-');
export const post = (path, body = {}) => send('POST', path, body, { 'Idempotency-Key': newKey() });

// Learn what the token allows: with a viewer's the page offers no button that changes anything.
let role = null;
export async function learnRole() {
  const found = await get('/info');
  role = found.role;
  return found;
}
export const looksOn = () => role === 'viewer';

export const wait = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });

const blobAt = async (path) => URL.createObjectURL(await (await request(path)).blob());

// An address for <img>, <video> and links where there is a token: that of a blob fetched with it.
export function address(path) {
  if (!fetched.has(path)) {
    fetched.set(path, blobAt(path).catch((error) => { fetched.delete(path); throw error; }));
    if (fetched.size > MOST_KEPT) {
      const [oldest, made] = fetched.entries().next().value;
      fetched.delete(oldest);
      made.then((url) => URL.revokeObjectURL(url), () => {});
    }
  }
  return fetched.get(path);
}

// Events as they happen, read with fetch, which can send a token where EventSource cannot.
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
      const data = /^data:(.*)$/m.exec(part); // every event is one line of data
      if (data) onEvent(JSON.parse(data[1]));
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
