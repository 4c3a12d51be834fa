// A rig: what its cameras see and how they are, its calibration, and the form that makes a capture.
import { offers, post } from './api.js';
import { actions, button } from './act.js';
import { calibration } from './calibrations.js';
import { card, element, failure, fold, quiet, size, title } from './dom.js';
import { picture } from './media.js';

const AGES = [[86400, 'day'], [3600, 'hour'], [60, 'minute']];

export function ago(moment) {
  const age = Math.max(0, (Date.now() - moment) / 1000);
  const found = AGES.find(([unit]) => age >= unit);
  if (!found) return 'just now';
  const count = Math.floor(age / found[0]);
  return `${count} ${found[1]}${count > 1 ? 's' : ''} ago`;
}

function cameraLine(camera) {
  const parts = [camera.serial && `serial ${camera.serial}`, camera.firmware && `firmware ${camera.firmware}`, camera.link,
    Number.isFinite(camera.temperature_c) && `${camera.temperature_c.toFixed(0)} °C`,
    Number.isFinite(camera.skew_s) && `skew ${(camera.skew_s * 1e6).toFixed(1)} µs`, camera.found];
  return parts.filter(Boolean).join(', ');
}

const isBad = (camera) => camera.connected === false || camera.ok === false || camera.passed === false;

function cameras(status) {
  const listed = Array.isArray(status.cameras) ? status.cameras : Object.entries(status.cameras ?? {}).map(([id, one]) => ({ id, ...one }));
  if (!listed.length) return null;
  const bad = listed.filter(isBad);
  const rows = listed.map((one) => element('li', { className: isBad(one) ? 'failed' : '' },
    element('strong', {}, one.id), ` ${isBad(one) ? 'fault' : one.connected === undefined && one.ok === undefined ? '' : 'ok'} ${cameraLine(one)}`));
  return [
    bad.length ? failure(`Fault in ${bad.map((one) => one.id).join(', ')}`) : null,
    fold(`cameras-${status.id}`, `Cameras (${listed.length})`, element('ul', { className: 'rows' }, rows)),
  ];
}

function checks(status) {
  const found = status.preflight?.checks ?? status.checks ?? [];
  if (!Array.isArray(found) || !found.length) return null;
  const failed = found.filter((check) => check.passed === false);
  const at = status.preflight?.created ?? status.preflight?.at;
  const age = at ? `, ${ago(typeof at === 'number' ? at * 1000 : Date.parse(at))}` : '';
  const rows = found.map((check) => element('li', { className: check.passed === false ? 'failed' : '' },
    element('strong', {}, `${check.passed === false ? 'fails' : check.passed ? 'pass' : '–'} ${check.name}`), `: ${check.found}`,
    check.passed === false && check.change ? `; ${check.change}` : ''));
  return [
    ...failed.map((check) => failure(`${check.name}: ${check.found}; ${check.change}`)),
    fold(`checks-${status.id}`, `Preflight: ${failed.length ? `${failed.length} of ${found.length} fail` : 'ready'}${age}`, element('ul', { className: 'rows' }, rows)),
  ];
}

function room(status) {
  const free = status.disk_free_bytes ?? status.disk?.free_bytes ?? status.free_bytes;
  const fits = status.seconds_that_fit ?? status.disk?.seconds ?? status.recording_s ?? status.fits_s;
  if (!Number.isFinite(free)) return null;
  return element('p', { className: Number.isFinite(fits) && fits < 10 ? 'failed' : 'quiet' },
    `Disk: ${size(free)} free${Number.isFinite(fits) ? `, ${fits.toFixed(0)} s of recording fit` : ''}`);
}

function look(item, context) {
  if (!offers('POST', '/rigs/{}/look')) return quiet('This service has no live view.');
  const seen = context.looks.get(item.id);
  if (!seen) return element('div', { className: 'view empty' }, quiet('Look shows what each camera sees.'));
  const path = `/v1/rigs/${item.id}/look.png?of=${encodeURIComponent(seen)}`;
  return element('div', { className: 'view' }, picture(path, `What the ${item.cameras.length} cameras of ${item.name} see`));
}

function watching(item, context) {
  if (!offers('POST', '/rigs/{}/look')) return null;
  const box = element('input', { type: 'checkbox', id: `live-${item.id}` });
  box.onchange = (event) => context.watch(item.id, event.currentTarget.checked);
  return element('label', { className: 'check' }, box, 'Live');
}

const byId = (id) => document.getElementById(id);

function number(id, label, properties) {
  const input = element('input', { id, type: 'number', className: 'short', ...properties });
  return [element('label', { htmlFor: id }, label, input), input];
}

// Ticks and milliseconds are one length: writing one shows the other.
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
    ...(name && { name }),
  };
}

function form(item) {
  const endless = element('input', { type: 'checkbox', id: `endless-${item.id}` });
  endless.onchange = (event) => {
    for (const id of [`ticks-${item.id}`, `ms-${item.id}`]) byId(id).disabled = event.currentTarget.checked;
  };
  const [kept] = number(`pre-${item.id}`, 'Pre-trigger (ms)', { min: 0, max: 60000, step: 'any', placeholder: 'none' });
  const name = element('label', { htmlFor: `name-${item.id}` }, 'Name', element('input', { id: `name-${item.id}`, type: 'text', maxLength: 80, autocomplete: 'off' }));
  const record = button('Record', `record-${item.id}`, () => post(`/rigs/${item.id}/captures`, requested(item)), { plain: false, disabled: item.busy !== null, done: 'The rig records' });
  const made = element('form', { id: `form-${item.id}`, className: 'fields capture' }, lengths(item),
    element('label', { className: 'check' }, endless, 'Until stopped'), kept, name, actions(record));
  const act = record.onclick;
  record.type = 'submit';
  record.onclick = null;
  made.onsubmit = (event) => {
    event.preventDefault();
    act({ currentTarget: byId(`record-${item.id}`) });
  };
  return made;
}

export function rig(item, context) {
  const status = { ...context.statuses.get(item.id), id: item.id };
  const preflight = offers('POST', '/rigs/{}/preflight');
  return card(`rig-${item.id}`,
    title(item.name, item.busy ? 'recording' : 'idle'),
    quiet(`${item.cameras.length} cameras, ${item.tick_rate_hz / 1000} kHz, ${item.devices}`),
    look(item, context),
    actions(
      offers('POST', '/rigs/{}/look') && button('Look', `look-${item.id}`, () => context.look(item.id), { disabled: item.busy !== null }),
      watching(item, context),
      preflight && button('Preflight', `preflight-${item.id}`, () => post(`/rigs/${item.id}/preflight`), { disabled: item.busy !== null, done: 'The preflight is queued' })),
    room(status),
    cameras(status),
    checks(status),
    calibration(item, context),
    element('h4', {}, 'Record'),
    form(item));
}
