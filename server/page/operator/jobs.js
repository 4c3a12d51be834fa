// The queue: the state of each job, its results, and what can be done with it.
import { post, send } from './api.js';
import { actions, asking, button, link, patiently, removal } from './act.js';
import { again } from './again.js';
import { answer } from './answer.js';
import { curve } from './curve.js';
import { bar, byId, card, element, failure, fold, quiet, seconds, since, size, title, when } from './dom.js';
import { labelling, note } from './labels.js';
import { artefact, download, enlarging, renewed, video } from './media.js';
import { heading } from './naming.js';
import { outlook } from './outlook.js';
import { ended, has, of } from './results.js';
import { box } from './selection.js';
import { inWords, JOBS, OPTIONS } from './words.js';
import { openPictures } from './zoom.js';

const SCORES = [['psnr_db', 'held-out PSNR', 'dB', 2], ['ssim', 'SSIM', '', 3], ['abs_rel', 'depth AbsRel', '', 4], ['counts.rmse', 'count error', 'spikes', 3]];
const MOST_LINKS = 3;

const stagesOf = (item, context) => (item.type === 'reconstruct' ? [...(item.request.follow ? ['follow'] : []), ...context.stages] : [item.type]);
const path = (item, rest = '') => `/jobs/${item.id}${rest}`;

function stages(item, context) {
  const names = stagesOf(item, context);
  if (names.length < 2) return null;
  const at = item.status === 'done' ? names.length : names.indexOf(item.stage);
  return element('ol', { className: 'stages', ariaLabel: 'Stages' }, names.map((name, i) => {
    const state = i < at ? 'done' : i > at || at < 0 ? 'waiting' : item.status;
    const took = item.seconds[name] ? ` ${seconds(item.seconds[name])}` : '';
    return element('li', { className: state, ariaCurrent: i === at ? 'step' : null },
      name, took, element('span', { className: 'hidden' }, ` ${state}`));
  }));
}

function progress(item) {
  if (item.status !== 'running') return null;
  const percent = `${Math.round(item.fraction * 100)} %`;
  return element('div', {},
    bar(`${item.stage ?? 'starting'} ${percent}`, item.fraction),
    element('p', {}, `${item.stage ?? 'starting'} ${percent} ${inWords(item.message)}`));
}

function warnings(item) {
  return item.warnings.map((text) => failure(inWords(text)));
}

function scores(item) {
  const { steps, scores: found } = of(item.id);
  if (item.status !== 'done' || !found) return null;
  const parts = SCORES.filter(([key]) => Number.isFinite(found[key])).map(([key, name, unit, digits]) => `${name} ${found[key].toFixed(digits)} ${unit}`.trim());
  const after = steps ? `, after ${steps} step${steps > 1 ? 's' : ''} of training` : '';
  return parts.length ? element('p', {}, `Final score on ${found.held_out ?? 'the held-out camera'}: ${parts.join(', ')}${after}`) : null;
}

const VERDICTS = {
  ready: ['Ready', 'Not ready'], sound: ['Every byte is as it was written', 'Damaged since it was written'],
  fits: ['The calibration still fits', 'The calibration no longer fits'],
};

// The answer of a job such as a check, in a line.
function verdict(item) {
  const found = of(item.id).answer;
  if (!found || item.status !== 'done') return null;
  const word = Object.keys(VERDICTS).find((name) => name in found);
  if (!word) return found.summary ? element('p', {}, found.summary) : null;
  const more = [...(found.checks ?? []).filter((check) => check.passed === false).map((check) => `${check.name} ${check.found}`), ...(found.moved ?? [])];
  return element('p', { className: found[word] ? '' : 'failed' }, `${VERDICTS[word][found[word] ? 0 : 1]}${more.length ? `: ${more.join(', ')}` : ''}`);
}

function curveOf(item) {
  const found = of(item.id);
  if (ended(item) && found.scored) return curve(found.scored, 'Held-out camera during training', 'held-out');
  return item.status === 'queued' ? null : curve(found.points, 'Training images', 'training');
}

const archive = (item, id, label) => download(`${id}-${item.id}`, `/v1/jobs/${item.id}/archive`, `${item.id}.zip`, label);

function results(item) {
  const found = of(item.id);
  if (!ended(item) || !found.artefacts.length) return null;
  const content = element('div', {},
    has(item, 'orbit.mp4') && video(artefact(item.id, 'orbit.mp4'), `Orbit of ${item.id}`),
    element('ul', { className: 'files' }, found.artefacts.slice(0, 60).map((one) => element('li', {},
      download(`file-${item.id}-${one.name}`, artefact(item.id, one.name), one.name.split('/').at(-1), one.name),
      element('span', { className: 'quiet' }, size(one.bytes))))),
    found.artefacts.length > 60 && quiet(`and ${found.artefacts.length - 60} more, in the archive`),
    (found.answer ?? found.scores) && answer(found.answer ?? found.scores),
    actions(archive(item, 'archive', 'All as one archive')));
  return fold(`results-${item.id}`, `Results (${found.artefacts.length})`, content);
}

function log(item, context) {
  const found = of(item.id);
  const text = element('pre', { id: `log-text-${item.id}`, tabIndex: 0, ariaLabel: `Log of ${item.id}` }, found.log || 'Nothing yet.');
  return fold(`log-${item.id}`, 'Log', text, (open) => open && context.tail(item.id));
}

function restart(item, context) {
  const names = context.stages;
  const begun = names.slice(0, names.indexOf(item.stage) + 1);
  if (!ended(item) || item.type !== 'reconstruct' || !begun.length) return [];
  const id = `stage-${item.id}`;
  const choice = element('select', { id, ariaLabel: `Stage to do ${item.id} again from` }, begun.map((name) => element('option', { value: name }, name)));
  choice.value = begun.at(-1);
  const repeat = () => patiently(() => post(path(item, '/restart'), { stage: byId(id).value }));
  return [choice, button('Do again from here', `restart-${item.id}`, repeat, { done: `${item.id} is queued again` })];
}

function priority(item) {
  if (item.status !== 'queued') return [];
  const id = `priority-${item.id}`;
  const input = element('input', { id, type: 'number', min: 1, max: 1000, value: item.priority, className: 'short' });
  const set = () => send('PUT', path(item, '/priority'), { priority: Number(byId(id).value) });
  return [element('label', { htmlFor: id }, 'Priority ', input), button('Set', `prioritise-${item.id}`, set, { done: `${item.id} has a new priority` })];
}

// A button for a job on a finished reconstruction.
function further(label, type, item, context) {
  if (item.status !== 'done' || item.type !== 'reconstruct') return null;
  return asking(label, `${JOBS[type]} of ${item.name ?? item.id}`, type, { job: item.id }, item, context);
}

const refused = (item) => item.status === 'failed' && !item.resumable; // the same would be refused again

function manage(item, context) {
  const remove = ended(item) && removal(item, path(item), 'The job, its log and everything it made are deleted for good. Its capture stays.');
  const repeat = ended(item) && !refused(item) && again(item, context);
  const content = element('div', {}, actions(restart(item, context)),
    actions(labelling(item, path(item)), repeat, further('Evaluate…', 'evaluate', item, context), remove));
  return fold(`manage-${item.id}`, 'Manage', content);
}

// Links to the files of an export, to be had without opening anything.
function files(item) {
  if (item.type !== 'export' || item.status !== 'done') return [];
  const made = of(item.id).artefacts.filter((one) => one.name !== 'result.json');
  if (made.length > MOST_LINKS) return [archive(item, 'saved', `Download ${made.length} files`)];
  return made.map((one) => download(`save-${item.id}-${one.name}`, artefact(item.id, one.name), one.name.split('/').at(-1), `Download ${one.name} (${size(one.bytes)})`));
}

function main(item, context) {
  return actions(
    files(item),
    has(item, 'report.html') && link('Report', `report-${item.id}`, `/report.html?job=${item.id}`),
    has(item, 'viewer.json') && link('View in 4D', `viewer-${item.id}`, `/viewer.html?job=${item.id}`),
    further('Export…', 'export', item, context),
    refused(item) && again(item, context, false),
    item.resumable && button('Resume', `resume-${item.id}`, () => patiently(() => post(path(item, '/resume'))), { plain: false, done: `${item.id} goes on` }),
    !ended(item) && button('Cancel', `cancel-${item.id}`, () => post(path(item, '/cancel')), { done: `${item.id} is cancelled` }),
    priority(item));
}

const ABOUT = {
  holdout: (camera) => `scored on ${camera}`, budget_s: (s) => `budget ${s} s`, views: (cameras) => `trained on ${cameras.length} cameras`,
  disk_seconds: () => null, follow: () => 'begun while it was recorded', rig: () => null, apply: () => 'to be used at once', at_s: (s) => `at ${s} s`, tick_stride: (n) => `every ${n} planes`,
};

function about(item, context) {
  const { type, capture, job, name: given, priority: rank, ...request } = item.request;
  const options = Object.entries(request).filter(([, value]) => value !== null && value !== 'auto' && value !== false)
    .map(([name, value]) => (ABOUT[name] ?? ((one) => `${(OPTIONS[name] ?? name).toLowerCase()}: ${one}`))(value)).filter(Boolean);
  const target = item.name && context.nameOf(job ?? capture);
  return [when(item.created), target && `of ${target}`, ...options, item.id].filter(Boolean).join(' · ');
}

// The first thumbnail of a job, which opens all its pictures large.
function thumbnail(item) {
  const named = (pattern) => of(item.id).artefacts.map((one) => one.name).filter((name) => pattern.test(name));
  const [first] = named(/^thumbnails\/.*\.(png|jpg)$/);
  if (!first) return null;
  const all = [first, ...named(/\.(png|jpg)$/).filter((name) => name !== first)];
  return enlarging(artefact(item.id, first), `What ${item.id} made`, '', () => openPictures(item.name ?? item.id, all.map((name) => ({ path: artefact(item.id, name), label: name }))));
}

// What a training has learnt so far: in the thumbnail's place until there is one, and of its size from the beginning.
function learnt(item) {
  const { preview: found, id } = item, address = `/v1${path(item, '/preview')}`;
  const kept = item.status === 'done' ? byId(`preview-${id}`) : found; // until the thumbnails are learnt
  if (item.type !== 'reconstruct' || !(kept || item.status === 'running')) return null;
  const figure = (shown, caption) => element('figure', { id: `preview-${id}`, className: 'learnt' }, shown, element('figcaption', { className: 'quiet' }, caption));
  if (!found) return figure(element('p', { className: 'quiet empty' }, 'A first rendering comes as training begins'), '');
  const alt = `What ${id} has learnt by step ${found.steps}, as ${found.camera} would see it`;
  const large = () => openPictures(item.name ?? id, [{ path: `${address}?of=${found.at}`, label: alt }]);
  return figure(enlarging(address, alt, '', large, renewed(`preview-img-${id}`, address, found.at, alt)), `Rendered as ${found.camera}, step ${found.steps}, ${since(found.at)}`);
}

export function job(item, context) {
  return card(`job-${item.id}`,
    title(heading(item, context.nameOf), item.status, item.status, box('jobs', item)),
    quiet(about(item, context)),
    outlook(item),
    note(item),
    failure(inWords(item.error)),
    stages(item, context),
    progress(item),
    element('div', { className: 'outcome' }, thumbnail(item) ?? learnt(item), curveOf(item)),
    warnings(item),
    scores(item),
    verdict(item),
    main(item, context),
    element('div', { className: 'folds' }, results(item), log(item, context), manage(item, context)));
}

