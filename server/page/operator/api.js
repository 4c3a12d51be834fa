// Requests of the page to the service.
import { token, withToken } from '../token.js';

const MOST_KEPT = 200; // pictures fetched with a token
const fetched = new Map(); // path to promise of a blob's address
let offered = null; // every route, such as "GET /v1/jobs/{}"
let parameters = []; // query parameters of the list of jobs

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
  if (!response.ok) throw new Refused(response.status, await detailOf(response));
  return response;
}

async function detailOf(response) {
  try {
    return (await response.json()).detail ?? response.statusText;
  } catch {
    return `${response.status} ${response.statusText}`;
  }
}

export async function get(path) {
  return (await request(`/v1${path}`)).json();
}

export async function send(method, path, body, headers) {
  const response = await request(`/v1${path}`, { method, body, headers });
  return response.status === 204 ? null : response.json();
}

// One key a click, so that a request sent twice is done once.
export const post = (path, body = {}) => send('POST', path, body, { 'Idempotency-Key': newKey() });

function newKey() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

// Learn the routes of this service: an older one, or one built without a part, has fewer.
export async function learnRoutes() {
  const { paths } = await (await request('/openapi.json')).json();
  parameters = paths['/v1/jobs'].get.parameters;
  offered = new Set(Object.entries(paths).flatMap(([path, methods]) => Object.keys(methods).map((method) => route(method, path))));
}

// Learn what the token allows: with a viewer's the page offers no button that changes anything.
let role = null;
export async function learnRole() {
  const found = await get('/info');
  role = found.role;
  return found;
}
export const looksOn = () => role === 'viewer';

// The names a job's status may have.
export function statuses() {
  const { schema } = parameters.find(({ name }) => name === 'status') ?? {};
  return schema?.anyOf?.find((one) => one.enum)?.enum ?? [];
}

export const wait = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });

const route = (method, path) => `${method.toUpperCase()} ${path.replace(/\{[^}]*\}/g, '{}')}`;
export const offers = (method, path) => offered?.has(route(method, `/v1${path}`)) ?? false;

async function blobAt(path) {
  const response = await request(path);
  return URL.createObjectURL(await response.blob());
}

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
