// The calibration of a rig: which is in use, how good it is, and the versions to go back to.
import { get, offers, post, request } from './api.js';
import { actions, button, performed } from './act.js';
import { jobDialog } from './dialogs.js';
import { ago, element, fold, quiet } from './dom.js';
import { picture } from './media.js';

const figure = (value, digits, unit) => (Number.isFinite(value) ? `${value.toFixed(digits)} ${unit}` : null);

function inWords(found) {
  return [`version ${found.version}`, found.source, found.created && ago((Date.now() - Date.parse(found.created)) / 1000),
    figure(found.residual_px, 2, 'px residual'), figure(found.rotation_sd_deg, 3, '° sd')].filter(Boolean).join(', ');
}

// Choose a version, unless another person has changed it since this page looked.
async function choose(rig, version) {
  const current = await request(`/v1/rigs/${rig}/calibration`);
  await request(`/v1/rigs/${rig}/calibration`, { method: 'PUT', body: { version }, headers: { 'If-Match': current.headers.get('ETag') ?? '*' } });
}

function versions(item, context, current) {
  const listed = context.calibrations.get(item.id)?.items ?? [];
  const all = [...listed, { version: 0, source: 'nominal', created: null }];
  return element('ul', { className: 'rows' }, all.map((one) => element('li', { data: { key: String(one.version) } }, inWords(one),
    one.version === current.version ? element('strong', {}, ' in use')
      : actions(button('Use', `use-${item.id}-${one.version}`, () => choose(item.id, one.version), { done: `Version ${one.version} is in use` })))));
}

function calibrate(item, context) {
  const captures = context.captures.filter((one) => one.rig === item.id && one.status === 'done');
  const schema = context.options.calibrate;
  if (!schema || !captures.length) return quiet('Record a capture to calibrate from.');
  const made = button('Calibrate…', `calibrate-${item.id}`, async () => {});
  const choices = { enum: captures.map((one) => one.id), default: captures[0].id };
  const asked = { ...schema, properties: { from: choices, ...schema.properties } };
  const submit = ({ from, priority, ...values }) => performed(() => (offers('POST', '/rigs/{}/calibrations')
    ? post(`/rigs/${item.id}/calibrations`, { capture: from, ...values })
    : post('/jobs', { type: 'calibrate', capture: from, priority, ...values })), 'The calibration is queued');
  made.onclick = () => jobDialog(`Calibrate ${item.name}`, asked, [], submit, 'Queue');
  return actions(made);
}

export async function learnCalibration(rig) {
  if (!offers('GET', '/rigs/{}/calibration')) return null;
  const [current, listed] = await Promise.all([get(`/rigs/${rig}/calibration`),
    offers('GET', '/rigs/{}/calibrations') ? get(`/rigs/${rig}/calibrations`) : { items: [] }]);
  return { current, items: listed.items };
}

export function calibration(item, context) {
  const known = context.calibrations.get(item.id);
  if (!known) return element('div', {}, quiet(`Poses: ${item.poses}`), calibrate(item, context));
  const { current } = known;
  const shown = current.picture && offers('GET', '/rigs/{}/calibrations/{}/picture');
  const content = element('div', {},
    shown && picture(`/v1/rigs/${item.id}/calibrations/${current.version}/picture`, `Residuals of calibration ${current.version}`, 'preview'),
    versions(item, context, current),
    calibrate(item, context));
  return [quiet(`Calibration: ${inWords(current)}`), fold(`calibrations-${item.id}`, 'Calibrations', content)];
}
