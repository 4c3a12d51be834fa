// Details of jobs that the list does not have: artefacts, scores, curve and log, asked for once, when needed.
import { get, readEvents, request } from './api.js';
import { addFigure, scored } from './curve.js';
import { artefact } from './media.js';

const MOST_TEXT = 40_000; // characters of a log or result on the page
const MOST_READ = 200_000; // bytes of a file that is read for its figures
const HISTORY_MS = 3000, QUIET_MS = 300, LOOKS_MS = 5000;
const known = new Map();
let work = Promise.resolve(); // one request after another, so that a long list does not flood the service

export const ended = (item) => item.status !== 'queued' && item.status !== 'running';

export function of(id) {
  if (!known.has(id)) known.set(id, { artefacts: [], points: [], scores: null, answer: null, log: '', lines: 0, state: '' });
  return known.get(id);
}

// Return whether a job has made a file, of fewer than `most` bytes.
export const has = (item, name, most = Infinity) => of(item.id).artefacts.some((one) => one.name === name && one.bytes < most);

const json = async (id, name) => (await request(artefact(id, name))).json();

async function learnResults(item, found) {
  found.artefacts = (await get(`/jobs/${item.id}/artefacts`)).items;
  if (has(item, 'metrics.json', MOST_READ)) found.scores = await json(item.id, 'metrics.json');
  if (has(item, 'result.json', MOST_READ)) found.answer = await json(item.id, 'result.json');
  if (has(item, 'error_vs_time.json', MOST_READ)) {
    const history = await json(item.id, 'error_vs_time.json');
    const points = scored(history);
    found.steps = history.rows?.at(-1)?.steps;
    if (points.length > 1) found.scored = points;
  }
}

// Learn the course of a training that began before the page was opened.
async function learnHistory(item, draw) {
  const stop = new AbortController();
  let quiet = setTimeout(() => stop.abort(), HISTORY_MS);
  const told = (event) => {
    clearTimeout(quiet);
    quiet = setTimeout(() => stop.abort(), QUIET_MS); // past events arrive at once, new ones twice a second
    progressed(item.id, event);
    draw();
  };
  await readEvents(`/v1/jobs/${item.id}/events?after=0`, told, { after: 0, signal: stop.signal });
}

// Learn of the scene that a job shows while its capture is recorded, a few seconds after a picture of it.
function learnLooks(item, found, draw) {
  if (found.looked || has(item, 'viewer.json')) return;
  const look = async () => { found.artefacts = (await get(`/jobs/${item.id}/artefacts`)).items; };
  found.looked = setTimeout(() => look().then(draw, () => draw()).finally(() => { found.looked = null; }), LOOKS_MS);
}

// Ask for the details of jobs that the page lacks, and forget all other jobs; call `draw` when they arrive.
// If the page is not `live`, take figures from the list, one a second.
export function learn(jobs, live, draw) {
  for (const id of known.keys()) if (!jobs.some((item) => item.id === id)) known.delete(id);
  for (const item of jobs) {
    const found = of(item.id), before = found.state;
    found.state = item.status;
    if (item.stage === 'follow' && item.preview) learnLooks(item, found, draw);
    if (before !== item.status && ended(item)) work = work.then(() => learnResults(item, found)).then(draw, () => draw());
    else if (before !== item.status && item.status === 'running') learnHistory(item, draw).catch(() => draw()); // beside the others, which an endless stream would hold up
    if (!live && item.status === 'running' && item.stage === 'train') progressed(item.id, { kind: 'progress', seq: item.message, data: item });
  }
}

export function progressed(id, event) {
  if (event.kind !== 'progress') return;
  const found = of(id);
  found.points = addFigure(found.points, event.data, event.seq);
}

export async function readLog(id) {
  const found = of(id);
  const text = await (await request(`/v1/jobs/${id}/log?line=${found.lines}`)).text();
  const whole = text.slice(0, text.lastIndexOf('\n') + 1); // an unfinished line is read next time
  found.lines += whole.split('\n').length - 1;
  found.log = (found.log + whole).slice(-MOST_TEXT);
}
