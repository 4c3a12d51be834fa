// Lists rigs, captures and jobs, once a second while the page is seen.
const seen = new Map(); // what each list showed last: a list is only rebuilt when it changes, so focus stays put
const camerasOf = new Map(); // rig id to camera ids

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children.filter((child) => child != null));
  return made;
}

async function call(path, body) {
  const response = await fetch(`/v1${path}`, body === undefined ? {} : {
    method: 'POST', headers: { 'Content-Type': 'application/json' }, body: JSON.stringify(body),
  });
  const document = await response.json();
  if (!response.ok && response.status !== 503) throw new Error(document.detail);
  return document;
}

function notice(text) {
  const place = document.getElementById('notice');
  if (place.textContent !== text) place.textContent = text;
  place.hidden = !text;
}

function button(label, id, action, plain = false) {
  const made = element('button', { type: 'button', id, className: plain ? 'plain' : '' }, label);
  made.onclick = async () => {
    made.disabled = true;
    try { await action(); notice(''); } catch (error) { notice(error.message); }
    made.disabled = false;
    await refresh();
  };
  return made;
}

function title(name, status) {
  return element('div', { className: 'title' }, element('span', {}, name), element('span', { className: status }, status));
}

function bar(item, what) {
  if (item.status !== 'running') return null;
  const label = `${what}: ${item.stage ?? 'starting'}`;
  return element('progress', { max: 1, value: item.fraction, ariaLabel: label });
}

const when = (item) => new Date(item.created).toLocaleString();
const lasting = (item) => Object.entries(item.seconds).map(([stage, s]) => `${stage} ${s.toFixed(1)} s`).join(' · ');

function rig(item) {
  const ticks = element('input', { type: 'number', min: 1, value: 400, id: `ticks-${item.id}`, ariaLabel: `Ticks to record with ${item.id}` });
  const record = button('Record', `record-${item.id}`, () => call(`/rigs/${item.id}/captures`, { ticks: Number(ticks.value) }));
  record.disabled = item.busy !== null;
  return element('li', {},
    title(item.id, item.busy ? 'recording' : 'idle'),
    element('p', { className: 'quiet' }, `${item.cameras.length} cameras, ${item.tick_rate_hz / 1000} kHz, ${item.poses}, ${item.devices}`),
    element('div', { className: 'actions' }, ticks, element('span', { className: 'quiet' }, 'ticks'), record));
}

function heldOut(item) {
  const cameras = camerasOf.get(item.rig) ?? [];
  const choice = element('select', { id: `holdout-${item.id}`, ariaLabel: `Camera to keep out of ${item.id} and score on` },
    element('option', { value: '' }, 'train on all'),
    ...cameras.map((camera) => element('option', { value: camera }, `score on ${camera}`)));
  choice.value = cameras[Math.floor(cameras.length / 2)] ?? '';
  return choice;
}

function capture(item) {
  const holdout = heldOut(item);
  const start = button('Reconstruct', `start-${item.id}`, () => call('/jobs', { capture: item.id, ...(holdout.value && { holdout: holdout.value }) }));
  return element('li', {},
    title(item.name ?? item.id, item.status),
    element('p', { className: 'quiet' }, `${when(item)} · ${item.rig} · ${item.ticks} ticks`),
    bar(item, item.id),
    item.error && element('p', { className: 'failed' }, item.error),
    element('div', { className: 'actions' }, ...(item.status === 'done' ? [holdout, start] : [])));
}

function job(item) {
  const link = (name, label) => element('a', { href: `/v1/jobs/${item.id}/artefacts/${name}`, id: `${label}-${item.id}` }, label);
  const active = item.status === 'queued' || item.status === 'running';
  return element('li', {},
    title(item.id, item.status),
    element('p', { className: 'quiet' }, `${when(item)} · ${item.request.capture} · model ${item.request.model}`),
    bar(item, item.id),
    item.status === 'running' && item.stage ? element('p', {}, `${item.stage} ${Math.round(item.fraction * 100)}% ${item.message}`) : null,
    element('p', { className: 'quiet' }, lasting(item)),
    item.error && element('p', { className: 'failed' }, item.error),
    element('div', { className: 'actions' },
      item.status === 'done' ? link('report.html', 'Report') : null,
      item.status === 'done' ? link('orbit.mp4', 'Orbit') : null,
      item.status === 'done' ? element('a', { href: `/viewer.html?job=${item.id}`, id: `viewer-${item.id}` }, 'View in 4D') : null,
      active ? button('Cancel', `cancel-${item.id}`, () => call(`/jobs/${item.id}/cancel`, {}), true) : null,
      item.status === 'failed' || item.status === 'cancelled' ? button('Resume', `resume-${item.id}`, () => call(`/jobs/${item.id}/resume`, {}), true) : null,
      element('a', { href: `/v1/jobs/${item.id}/log`, id: `log-${item.id}` }, 'Log')));
}

function show(id, items, make, nothing) {
  const text = JSON.stringify(items);
  if (seen.get(id) === text) return;
  seen.set(id, text);
  const focused = document.activeElement?.id;
  const typed = new Map([...document.querySelectorAll('input, select')].map((input) => [input.id, input.value]));
  const made = items.length ? items.map(make) : [element('li', { className: 'quiet' }, nothing)];
  document.getElementById(id).replaceChildren(...made);
  for (const [name, value] of typed) { const input = document.getElementById(name); if (input) input.value = value; }
  if (focused) document.getElementById(focused)?.focus();
}

async function refresh() {
  try {
    const [ready, rigs, captures, jobs] = await Promise.all(['/readyz', '/rigs', '/captures', '/jobs'].map((path) => call(path)));
    Object.assign(document.getElementById('ready'), {
      textContent: ready.detail ? `Not ready: ${ready.detail}` : 'Ready', className: ready.detail ? 'failed' : '',
    });
    for (const item of rigs.items) camerasOf.set(item.id, item.cameras.map((camera) => camera.id));
    show('rigs', rigs.items, rig, 'No rig is configured.');
    show('captures', captures.items, capture, 'No captures yet. Record one with a rig.');
    show('jobs', jobs.items, job, 'No jobs yet. Start one from a capture.');
    if (document.getElementById('notice').textContent.startsWith('The service')) notice('');
  } catch (error) {
    notice(`The service does not answer: ${error.message}`);
  }
}

async function watch() {
  if (!document.hidden) await refresh();
  setTimeout(watch, 1000);
}
watch();
