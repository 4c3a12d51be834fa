// A rig: the view and health of its cameras, its calibration, and the form that makes a capture.
import { looksOn, post, rigPath } from './api.js';
import { actions, button } from './act.js';
import { calibration } from './calibrations.js';
import { ago, bar, byId, card, element, failure, fold, quiet, seconds, size, title } from './dom.js';
import { openLook } from './cameras.js';
import { enlarging } from './media.js';

const LEAST_S = 10; // seconds of recording that should fit on the disk
const SENSITIVITY = [['threshold', 'Threshold (‰ of nominal)'], ['exposure', 'Exposure (‰ of a tick)']]; // kept in the cameras

function cameraLine(one) {
  const known = (value, text) => (value === null || value === undefined ? null : text);
  return [one.fault, known(one.serial, `serial ${one.serial}`), known(one.firmware, `firmware ${one.firmware}`), one.port,
    known(one.link_mbit_s, `${one.link_mbit_s} Mbit/s`), one.link_errors ? `${one.link_errors} link errors` : null,
    known(one.skew_us, `skew ${one.skew_us?.toFixed(1)} µs`)].filter(Boolean).join(', ');
}

const row = (good, head, ...text) => element('li', { className: good === false ? 'failed' : '' }, element('strong', {}, head), ...text);

function cameras(status) {
  const listed = status.cameras ?? [];
  const known = listed.filter((one) => one.connected !== null);
  if (!known.length) return null;
  const lost = listed.filter((one) => one.connected === false);
  const skews = listed.map((one) => one.skew_us).filter((skew) => skew !== null && skew !== undefined);
  const skew = skews.length ? `, skew up to ${Math.max(...skews.map(Math.abs)).toFixed(1)} µs` : '';
  const rows = listed.map((one) => row(one.connected, one.id,
    ` ${one.connected === null ? 'unknown' : one.connected ? 'connected' : 'not connected'} `, element('span', { className: 'quiet' }, cameraLine(one))));
  return [
    lost.length > 0 && failure(lost.map((one) => `${one.id}: ${one.fault ?? 'not connected'}`).join('; ')),
    fold(`cameras-${status.rig}`, `${listed.length - lost.length} of ${listed.length} cameras connected${skew}`, element('ul', { className: 'rows' }, rows)),
  ];
}

function checks(status) {
  if (!status.preflight) return null;
  const { checks: found, age_s, ready } = status.preflight;
  const failed = found.filter((check) => check.passed === false);
  const rows = found.map((check) => row(check.passed, `${check.passed === null ? '–' : check.passed ? 'pass' : 'fail'} ${check.name}`, `: ${check.found}`));
  return [
    ...failed.map((check) => failure(`${check.name}: found ${check.found}, expected ${check.expected}; ${check.change}`)),
    fold(`checks-${status.rig}`, `Preflight: ${ready ? `${found.length} checks passed` : `${failed.length} of ${found.length} checks failed`}, ${ago(age_s)}`, element('ul', { className: 'rows' }, rows)),
  ];
}

function room({ disk, worker }) {
  return [
    worker === false && failure('No worker reaches these cameras; run spike4dgs worker.'),
    disk && element('p', { className: disk.seconds < LEAST_S ? 'failed' : 'quiet' }, `Disk: ${size(disk.free_bytes)} free, ${seconds(disk.seconds)} of recording fit`),
  ];
}

const DOING = { record: 'recording', look: 'looking', preflight: 'checking' };

// Show the capture or job that keeps the cameras busy.
function work(doing, item) {
  if (!doing) return null;
  const stop = () => post(`${rigPath(item.id)}/captures/${doing.id}/stop`);
  return element('div', {},
    bar(`${doing.name ?? doing.id}: ${DOING[doing.type] ?? doing.type}`, doing.fraction),
    doing.message && quiet(doing.message),
    doing.type === 'record' && actions(button('Stop', `stop-rig-${item.id}`, stop, { plain: false, done: 'The recording ends' })));
}

function look(item, status, context) {
  if (!status.look) return element('div', { className: 'view empty' }, quiet('Look shows what each camera sees.'));
  const path = `/v1${rigPath(item.id)}/look.png?of=${encodeURIComponent(status.look.etag)}`;
  return element('figure', { className: 'view' }, enlarging(path, `What the ${item.cameras.length} cameras of ${item.name} see`, '', () => openLook(item, context)),
    element('figcaption', { className: 'quiet' }, `Seen ${ago(status.look.age_s)}`));
}

function watching(item, context) {
  if (looksOn()) return null;
  const box = element('input', { type: 'checkbox', id: `live-${item.id}` });
  box.onchange = (event) => context.watch(item.id, event.currentTarget.checked);
  return element('label', { className: 'check' }, box, 'Live');
}

function number(id, label, properties) {
  const input = element('input', { id, type: 'number', className: 'short', ...properties });
  return [element('label', { htmlFor: id }, label, input), input];
}

// Two fields for one length, in ticks and in milliseconds; typing in one fills the other.
function lengths(item) {
  const perMs = item.tick_rate_hz / 1000;
  const [ticks, a] = number(`ticks-${item.id}`, 'Ticks', { min: 1, max: 10_000_000, step: 1, value: 400, required: true });
  const [ms, b] = number(`ms-${item.id}`, 'Milliseconds', { min: 0, step: 'any', value: 400 / perMs });
  a.oninput = (event) => { byId(b.id).value = event.currentTarget.value ? Number((event.currentTarget.value / perMs).toFixed(4)) : ''; };
  b.oninput = (event) => { byId(a.id).value = event.currentTarget.value ? Math.max(1, Math.round(event.currentTarget.value * perMs)) : ''; };
  return [ticks, ms];
}

function requested(item) {
  const open = byId(`endless-${item.id}`).checked;
  const kept = byId(`pre-${item.id}`).value, name = byId(`name-${item.id}`).value.trim();
  return {
    ...(open ? { until_stopped: true } : { ticks: Number(byId(`ticks-${item.id}`).value) }),
    ...(kept && { pre_trigger_ms: Number(kept) }),
    ...Object.fromEntries(SENSITIVITY.map(([key]) => [key, byId(`${key}-${item.id}`).value]).filter(([, value]) => value).map(([key, value]) => [key, Number(value)])),
    ...(name && { name }),
  };
}

function form(item) {
  const endless = element('input', { type: 'checkbox', id: `endless-${item.id}` });
  endless.onchange = (event) => {
    for (const id of [`ticks-${item.id}`, `ms-${item.id}`]) byId(id).disabled = event.currentTarget.checked;
  };
  const [kept] = number(`pre-${item.id}`, 'Pre-trigger (ms)', { min: 0, max: 60000, step: 'any', placeholder: 'none' });
  const sensitivity = SENSITIVITY.map(([key, label]) => number(`${key}-${item.id}`, label, { min: 1, step: 1, placeholder: 'as it is' })[0]);
  const name = element('label', { htmlFor: `name-${item.id}` }, 'Name', element('input', { id: `name-${item.id}`, type: 'text', maxLength: 80, autocomplete: 'off' }));
  const record = button('Record', `record-${item.id}`, () => post(`${rigPath(item.id)}/captures`, requested(item)), { plain: false, disabled: item.busy !== null, done: 'The rig records' });
  const made = element('form', { id: `form-${item.id}`, className: 'fields capture' }, lengths(item),
    element('label', { className: 'check' }, endless, 'Until stopped'), kept, sensitivity, name, actions(record));
  const act = record.onclick;
  Object.assign(record, { type: 'submit', onclick: null });
  made.onsubmit = (event) => {
    event.preventDefault();
    act({ currentTarget: byId(record.id) });
  };
  return made;
}

export function rig(item, context) {
  const status = context.statuses.get(item.id) ?? {};
  const doing = item.busy && context.entry(item.busy);
  return card(`rig-${item.id}`,
    title(item.name, item.busy ? 'recording' : 'idle', item.busy ? DOING[doing?.type] ?? 'busy' : 'idle'),
    quiet(`${item.cameras.length} cameras, ${item.tick_rate_hz / 1000} kHz, ${item.devices}`),
    look(item, status, context),
    work(doing, item),
    actions(
      button('Look', `look-${item.id}`, () => context.look(item.id), { disabled: item.busy !== null }),
      watching(item, context),
      button('Preflight', `preflight-${item.id}`, () => post(`${rigPath(item.id)}/preflight`), { disabled: item.busy !== null, done: 'The preflight is queued' })),
    looksOn() ? null : [element('h4', {}, 'Record'), form(item), element('h4', {}, 'State')],
    room(status),
    cameras(status),
    checks(status),
    calibration(item, context));
}
