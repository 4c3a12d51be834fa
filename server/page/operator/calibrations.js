// The calibration of a rig: the one in use, its quality, and the versions to go back to.
import { get, post, request, rigPath } from './api.js';
import { actions, button, jobDialog, opener, performed } from './act.js';
import { ago, element, fold, quiet } from './dom.js';
import { enlarging } from './media.js';
import { openPictures } from './zoom.js';

const figure = (value, digits, unit) => (Number.isFinite(value) ? `${value.toFixed(digits)} ${unit}` : null);

const SOURCES = { nominal: 'as drawn', natural: 'from a scene', board: 'from a board', pixels: 'of the pixels', uploaded: 'from a file' };

function inWords(found) {
  return [`version ${found.version}`, SOURCES[found.source] ?? found.source, found.created && ago((Date.now() - Date.parse(found.created)) / 1000),
    figure(found.residual_px, 2, 'px residual'), figure(found.rotation_sd_deg, 3, '° sd')].filter(Boolean).join(', ');
}

// Choose a version, unless somebody else has chosen one since this page asked.
async function choose(rig, version) {
  const current = await request(`/v1${rigPath(rig)}/calibration`);
  await request(`/v1${rigPath(rig)}/calibration`, { method: 'PUT', body: { version }, headers: { 'If-Match': current.headers.get('ETag') ?? '*' } });
}

function versions(item, context, current) {
  const listed = context.calibrations.get(item.id)?.items ?? [];
  const all = [...listed, { version: 0, source: 'nominal', created: null }];
  return element('ul', { className: 'rows' }, all.map((one) => element('li', { className: 'choice', id: `version-${item.id}-${one.version}` }, element('span', {}, inWords(one)),
    one.version === current.version ? element('strong', {}, 'in use')
      : actions(button('Use', `use-${item.id}-${one.version}`, () => choose(item.id, one.version), { done: `Version ${one.version} is in use` })))));
}

// A button to calibrate a rig from one of `captures`: its cameras or, with a dark capture too, its pixels.
export const calibrating = (heading, item, rig, captures, context) => rig
  && opener('Calibrate…', `calibrate-${item.id}`, () => calibrateDialog(heading, rig, captures, context));

function calibrateDialog(heading, rig, captures, context) {
  const { board, apply, name, priority } = context.options.calibrate.properties;
  const named = (ids) => ({ type: 'string', enum: ids, names: ids.map(context.nameOf) });
  const asked = { ...context.options.calibrate, required: ['from'],
    properties: { ...(captures.length > 1 && { from: named(captures) }), board, name, apply: { ...apply, default: true }, dark: named(finished(rig, context)), priority } };
  const submit = ({ from = captures[0], dark: without, ...values }) => performed(
    () => post(`${rigPath(rig)}/calibrations`, { ...(without ? { flat: from, dark: without } : { capture: from }), ...values }), 'The calibration is queued');
  jobDialog(heading, asked, [], submit);
}

const finished = (rig, context) => context.captures.filter((one) => one.rig === rig && one.status === 'done').map((one) => one.id);

function calibrate(item, context) {
  const captures = finished(item.id, context);
  if (!captures.length) return quiet('Record a capture to calibrate from.');
  return actions(calibrating(`Calibrate ${item.name}`, item, item.id, captures, context));
}

export async function learnCalibration(rig) {
  const [current, { items }] = await Promise.all([get(`${rigPath(rig)}/calibration`), get(`${rigPath(rig)}/calibrations`)]);
  return { current, items };
}

function residuals(item, version) {
  const path = `/v1${rigPath(item.id)}/calibrations/${version}/picture`, label = `Residuals of calibration ${version}`;
  return enlarging(path, label, 'preview', () => openPictures(label, [{ path, label }]));
}

export function calibration(item, context) {
  const known = context.calibrations.get(item.id);
  if (!known) return element('div', {}, quiet(`Poses: ${item.poses}`), calibrate(item, context));
  const { current } = known;
  const content = element('div', {},
    current.picture && residuals(item, current.version),
    versions(item, context, current),
    calibrate(item, context));
  return [quiet(`Calibration: ${inWords(current)}`), fold(`calibrations-${item.id}`, 'Calibrations', content)];
}
