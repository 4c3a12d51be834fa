// Requests of the page to the service.
import { token, withToken } from '../token.js';

const MOST_KEPT = 200; // pictures fetched with a token
const fetched = new Map(); // path to promise of a blob's address

export class Refused extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

export async function request(path, { method = 'GET', body, headers = {}, signal } = {}) {
  const all = withToken(body === undefined ? headers : { ...headers, 'Content-Type': 'application/json' });
  let response;
  try {
    response = await fetch(path, { method, headers: all, signal, body: body === undefined ? undefined : JSON.stringify(body) });
  } catch (error) {
    if (error.name === 'AbortError') throw error;
    throw new Refused(0, 'The service does not answer; check that it runs');
  }
  if (response.status === 401) document.dispatchEvent(new CustomEvent('token-wanted'));
  if (response.ok) return response;
  const { detail } = await response.json().catch(() => ({}));
  throw new Refused(response.status, detail ?? `${response.status} ${response.statusText}`);
}

export const get = async (path) => (await request(`/v1${path}`)).json();

export async function send(method, path, body, headers) {
  const response = await request(`/v1${path}`, { method, body, headers });
  return response.status === 204 ? null : response.json();
}

// One key a click, so that a request sent twice is done once.
export const post = (path, body = {}) => send('POST', path, body, { 'Idempotency-Key': newKey() });

function newKey() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

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

// An address for <img>, <video> and links: the path itself or, with a token, a blob fetched with it.
export function address(path) {
  if (!token()) return Promise.resolve(path);
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
