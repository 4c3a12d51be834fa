// The operator's page: rigs, captures and jobs, kept up to date by events or by asking once a second.
import { complain, onChange } from './operator/act.js';
import { follow, get, learnRole, looksOn, post, request, rigPath, setToken, token, wait } from './operator/api.js';
import { learnCalibration } from './operator/calibrations.js';
import { isFocusing } from './operator/cameras.js';
import { capture } from './operator/captures.js';
import { byId, element, keepingFocus, patchChildren } from './operator/dom.js';
import { offerImport } from './operator/importing.js';
import { job } from './operator/jobs.js';
import { heading } from './operator/naming.js';
import { refreshLarge } from './operator/large.js';
import { forCaptures, forJobs } from './operator/many.js';
import * as results from './operator/results.js';
import { rig } from './operator/rigs.js';
import { asked, onSearch, sought, tell } from './operator/search.js';
import { bar, onChosen, settle } from './operator/selection.js';

const SLOW_MS = 10_000, QUICK_MS = 1000, LOOK_MS = 5000, FOCUS_MS = 200, TAIL_MS = 1000;
const PAGE = { captures: 20, jobs: 30 };

const limits = { ...PAGE }, tailing = new Set(), watched = new Set();
const context = {
  options: {}, stages: [], rigs: new Map(), captures: [], jobs: [], shown: { captures: [], jobs: [] }, next: {}, names: new Map(),
  statuses: new Map(), calibrations: new Map(), manifests: new Map(),
  entry: (id) => [...context.captures, ...context.jobs].find((one) => one.id === id),
  nameOf: (id) => context.names.get(id) ?? id ?? 'nothing',
  camerasOf: (item) => {
    const id = item.request?.capture ?? item.id;
    const recorded = context.manifests.get(id)?.cameras; // the truth: an import may have any, and a rig others by now
    if (recorded?.length) return recorded.map((camera) => camera.id);
    const rig = item.rig ?? context.captures.find((one) => one.id === id)?.rig;
    return (context.rigs.get(rig) ?? [...context.rigs.values()][0])?.cameras.map((camera) => camera.id) ?? [];
  },
  look, watch, tail,
};
let drawn = 0, live = false, seen = new Date();

function draw() {
  if (!drawn) drawn = requestAnimationFrame(() => { drawn = 0; keepingFocus(drawNow); });
}

function list(id, items, make, nothing) {
  const none = () => [element('li', { className: 'quiet', id: `no-${id}` }, nothing)];
  patchChildren(byId(id), items.length ? items.map((item) => make(item, context)) : none());
}

function older(kind) {
  const made = element('button', { type: 'button', id: `older-${kind}`, className: 'plain' }, `More ${kind}`);
  made.onclick = () => { limits[kind] = Math.min(1000, limits[kind] + PAGE[kind]); anew(); };
  patchChildren(byId(`${kind}-more`), context.next[kind] ? [made] : []);
}

function drawNow() {
  list('rigs', [...context.rigs.values()], rig, 'No rig is configured; see SPIKE4DGS_RIGS.');
  const { captures, jobs } = context.shown;
  list('captures', captures, capture, sought() ? 'No such captures.' : 'No captures yet. Record one with a rig.');
  list('jobs', jobs, job, sought() || byId('jobs-status').value ? 'No such jobs.' : 'No jobs yet. Start one from a capture.');
  patchChildren(byId('captures-chosen'), bar('captures', captures, forCaptures(context)));
  patchChildren(byId('jobs-chosen'), bar('jobs', jobs, forJobs(context)));
  settle('captures', captures);
  settle('jobs', jobs);
  tell(context.shown, context.next);
  older('captures');
  older('jobs');
  refreshLarge();
  for (const log of document.querySelectorAll('details[open] > pre[id^=log-text]')) {
    if (log.dataset.length !== String(log.textContent.length)) log.scrollTop = log.scrollHeight;
    log.dataset.length = log.textContent.length;
  }
}

// Ask for the lists; a second call joins a request that is under way.
let asking = null;
function refresh() {
  asking ??= refreshed().finally(() => { asking = null; });
  return asking;
}

// Ask for them anew: a request under way may ask for something else.
const anew = () => (asking ?? Promise.resolve()).then(refresh);

async function refreshed() {
  const status = byId('jobs-status').value;
  try {
    const list = `/captures?limit=${limits.captures}`, q = asked();
    const [rigs, captures, jobs, all] = await Promise.all([get('/rigs'), get(`${list}${q}`),
      get(`/jobs?order=work&limit=${limits.jobs}${status && `&status=${status}`}${q}`), q ? get(list) : null]);
    Object.assign(context, { captures: all ? joined(captures.items, all.items) : captures.items, jobs: jobs.items,
      shown: { captures: captures.items, jobs: jobs.items.filter((item) => item.type !== 'look') }, next: { captures: captures.next, jobs: jobs.next } });
    context.rigs = new Map(rigs.items.map((item) => [item.id, item]));
    for (const item of context.captures) context.names.set(item.id, item.name ?? item.id);
    for (const item of context.jobs) context.names.set(item.id, heading(item, context.nameOf));
    results.learn(context.jobs, live, draw);
    lost('');
    await learnManifests();
  } catch (error) {
    lost(error.status === 401 ? '' : error.message);
  }
  draw();
}

// What the forms offer does not depend on what is searched for.
const joined = (found, all) => [...found, ...all.filter((one) => !found.some((other) => other.id === one.id))];

// Show a fault of the connection until it is over; a complaint about a request stays to be read.
function lost(text) {
  const notice = byId('notice');
  if (!text) seen = new Date();
  document.body.classList.toggle('away', Boolean(text));
  byId('news').hidden = Boolean(text);
  if (text) complain(`${text}. What is shown is of ${seen.toLocaleTimeString()}.`);
  else if (notice.dataset.lost) complain('');
  notice.dataset.lost = text ? 'yes' : '';
}

async function learnManifests() {
  const verified = context.jobs.filter((item) => item.type === 'verify' && results.ended(item)).map((item) => item.request.capture);
  const version = (id) => verified.filter((one) => one === id).length; // a later verification may have found damage
  const missing = context.captures.filter((item) => item.status === 'done' && context.manifests.get(item.id)?.at !== version(item.id));
  for (const { id } of missing) context.manifests.set(id, await learnManifest(id, version(id)));
}

// A manifest that cannot be read is asked for again, but not that of a recording which is damaged (409) and stays so.
async function learnManifest(id, at) {
  try {
    return { at, ...await get(`/captures/${id}/manifest`) };
  } catch (error) {
    return { at: error.status === 409 ? at : undefined, fault: error.message, cameras: [] };
  }
}

const learnStatus = async (id) => context.statuses.set(id, await get(`${rigPath(id)}/status`).catch(() => context.statuses.get(id) ?? {}));

async function learnSlowly() {
  const ready = await get('/readyz').then(() => null, (error) => error.message);
  Object.assign(byId('ready'), { textContent: ready ? `Not ready: ${ready}` : 'Ready', className: ready ? 'failed' : 'done' });
  for (const id of context.rigs.keys()) {
    await learnStatus(id);
    context.calibrations.set(id, await learnCalibration(id).catch(() => context.calibrations.get(id) ?? null));
  }
  draw();
}

function happened(event) {
  const item = context.entry(event.entry);
  if (event.kind === 'progress' && item) {
    if (!results.ended(item)) Object.assign(item, event.data, { status: 'running' });
    results.progressed(event.entry, event);
    draw();
    return;
  }
  if (event.kind === 'status' && item) item.status = event.data.status;
  clearTimeout(happened.soon);
  happened.soon = setTimeout(() => refresh().then(learnSlowly), 100);
}

async function look(id) {
  const made = await post(`${rigPath(id)}/look`);
  for (let tries = 0; made?.id && tries < 60; tries += 1) {
    const found = await get(`/jobs/${made.id}`);
    if (found.status === 'failed') throw new Error(found.error ?? 'the look failed');
    if (results.ended(found)) break;
    await wait(500);
  }
  await learnStatus(id);
  draw();
}

async function watch(id, wanted) {
  if (wanted) watched.add(id);
  else watched.delete(id);
  while (watched.has(id)) {
    const free = context.rigs.get(id)?.busy === null && !document.hidden;
    if (free) await look(id).catch((error) => complain(error.message));
    await wait(isFocusing(id) ? FOCUS_MS : LOOK_MS);
  }
}

async function tail(id) {
  if (tailing.has(id)) return;
  tailing.add(id);
  while (byId(`log-${id}`)?.open) {
    await results.readLog(id).catch(() => {});
    draw();
    await wait(TAIL_MS);
  }
  tailing.delete(id);
}

async function every(pause, act) {
  for (;;) {
    if (!document.hidden) await act().catch(() => {});
    await wait(pause());
  }
}

function heard(arrive) {
  live = arrive;
  byId('news').textContent = live ? 'Up to date' : 'Asking once a second: no events arrive.';
}

async function begin() {
  try {
    await start();
  } catch (error) {
    if (error.status === 401) return; // the page starts again once the token is entered
    lost(error.message);
    setTimeout(begin, 2000);
  }
}

async function start() {
  const { paths } = await (await request('/openapi.json')).json();
  [context.options, { stages: context.stages }] = await Promise.all([get('/options'), learnRole()]);
  const { schema } = paths['/v1/jobs'].get.parameters.find(({ name }) => name === 'status');
  byId('jobs-status').append(...schema.anyOf.find((one) => one.enum).enum.map((status) => new Option(status)));
  byId('role').hidden = !looksOn();
  offerImport(byId('import'), byId('captures').closest('section'), context);
  await refresh();
  follow('/v1/events', happened, heard);
  every(() => (live ? SLOW_MS : QUICK_MS), refresh);
  every(() => SLOW_MS, learnSlowly);
}

document.addEventListener('token-wanted', () => {
  if (token()) complain('The service does not know this token.');
  setToken('');
  byId('token-form').hidden = false;
});
byId('token-form').onsubmit = (event) => {
  event.preventDefault();
  setToken(byId('token').value.trim());
  location.reload(); // so that pictures and links are made with the token
};
byId('jobs-status').onchange = anew;
onSearch(anew);
onChosen(draw);
onChange(async () => {
  await anew();
  learnSlowly();
});
begin();
