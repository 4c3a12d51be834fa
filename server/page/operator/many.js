// What is done with several captures or jobs at once. What the service refuses is named, and the rest is done.
import { post, send, wait } from './api.js';
import { complain, dialog, formOf, jobDialog, jobFields, opener, patiently, performed, say } from './act.js';
import { element, quiet, size } from './dom.js';
import { ended, of } from './results.js';
import { unchoose } from './selection.js';
import { counted, inWords, JOBS } from './words.js';

const MOST_NAMED = 8, PAUSE_MS = 1000, MOST_TRIES = 120;
const nameOf = (item) => item.name ?? item.id;

// Do something for one item, waiting where the service asks for fewer requests.
async function once(act) {
  for (let tries = 1; ; tries += 1) {
    try {
      return await patiently(act);
    } catch (error) {
      if (error.status !== 429 || tries === MOST_TRIES) throw error;
    }
    await wait(PAUSE_MS);
  }
}

// Do `act` for each item; return those that were refused, with the reason.
async function each(items, act) {
  const refused = [];
  for (const item of items) {
    try {
      await once(() => act(item));
    } catch (error) {
      if (error.status === 0 || error.status === 401) throw error; // the service is gone: the others would fail alike
      refused.push({ item, reason: error.message });
    }
  }
  return refused;
}

// Do `work`, which returns what was refused, and say the outcome.
// What was done is no longer chosen, before the lists are shown again: a person may choose anew meanwhile.
async function outcome(kind, items, done, work) {
  let refused = [];
  await performed(async () => {
    refused = await work();
    const left = refused.map(({ item }) => item.id);
    unchoose(kind, items.map((item) => item.id).filter((id) => !left.includes(id)));
  }, '');
  if (!refused.length) return say(`${counted(items.length, kind.slice(0, -1))} ${done}`);
  const why = refused.map(({ item, reason }) => `${nameOf(item)}: ${inWords(reason)}`).join('; ');
  return complain(`${items.length - refused.length} of ${items.length} ${done}. Refused: ${why}`);
}

// Queue a job for each item: together or, where one of them is refused, one by one.
async function queued(items, requestOf) {
  try {
    await once(() => post('/jobs:batch', { jobs: items.map(requestOf) }));
    return [];
  } catch (error) {
    if (!(error.status >= 400 && error.status < 500) || error.status === 401 || items.length === 1) {
      if (items.length === 1 && error.status >= 400) return [{ item: items[0], reason: error.message }];
      throw error;
    }
  }
  return each(items, (item) => post('/jobs', requestOf(item)));
}

const listed = (items) => element('ul', { className: 'rows' },
  items.slice(0, MOST_NAMED).map((item) => element('li', {}, nameOf(item))),
  items.length > MOST_NAMED && element('li', {}, `and ${items.length - MOST_NAMED} more`));

// A button for those of the chosen that it can help; off where there are none.
const offer = (label, id, items, act, { asks = true, ...options } = {}) => opener(
  items.length ? `${label} ${items.length}${asks ? '…' : ''}` : label, id, act, { ...options, disabled: !items.length });

function removal(kind, items, bytes, detail, path) {
  const heading = `Delete ${counted(items.length, kind.slice(0, -1))}, ${bytes}?`;
  const act = () => outcome(kind, items, 'deleted', () => each(items, (item) => send('DELETE', path(item))));
  const ask = () => dialog(heading, element('div', {}, listed(items), quiet(detail)), act, 'Delete', true).focus();
  return offer('Delete', `delete-${kind}`, items, ask, { danger: true });
}

// The size of recordings, as far as it is known here.
function recorded(items, context) {
  const known = items.map((item) => context.manifests.get(item.id)?.cameras).filter((cameras) => cameras?.length);
  const bytes = known.flat().reduce((sum, camera) => sum + camera.bytes, 0);
  const unknown = items.length - known.length;
  return `${size(bytes)}${unknown ? ` and ${unknown} of unknown size` : ''}`;
}

const made = (items) => size(items.flatMap((item) => of(item.id).artefacts).reduce((sum, one) => sum + one.bytes, 0));

// The cameras that all of the rigs have.
function common(items, context) {
  const [first, ...others] = items.map((item) => context.camerasOf(item));
  return first.filter((camera) => others.every((cameras) => cameras.includes(camera)));
}

// The types of jobs that work on one capture; a calibration is of a rig, which its own form asks for.
const typesOf = ({ options }) => Object.keys(options).filter((name) => 'capture' in options[name].properties && name !== 'calibrate');

function queueing(items, context) {
  const ask = () => {
    const choice = element('select', { id: 'batch-type' }, typesOf(context).map((name) => element('option', { value: name }, JOBS[name] ?? name)));
    const place = element('div');
    let form;
    choice.onchange = () => {
      form = jobFields(formOf(choice.value, context), common(items, context));
      place.replaceChildren(form.content);
    };
    choice.onchange();
    const head = element('div', { className: 'fields' }, element('label', { htmlFor: choice.id }, 'Job', choice));
    const requestOf = (item) => ({ type: choice.value, capture: item.id, ...form.values() });
    const submit = () => outcome('captures', items, 'have a job queued', () => queued(items, requestOf));
    dialog(`Jobs for ${counted(items.length, 'capture')}`, [head, place], submit, 'Queue');
  };
  return offer('Queue jobs for', 'batch-captures', items, ask, { plain: false });
}

function exporting(items, context) {
  const submit = (values) => outcome('jobs', items, 'have an export queued', () => queued(items, (item) => ({ type: 'export', job: item.id, ...values })));
  const ask = () => jobDialog(`Export ${counted(items.length, 'reconstruction')}`, formOf('export', context), common(items, context), submit);
  return offer('Export', 'export-jobs', items, ask, { plain: false });
}

export const forCaptures = (context) => (items) => {
  const over = items.filter(ended);
  return [
    queueing(items.filter((item) => item.status === 'done'), context),
    removal('captures', over, recorded(over, context), 'The recordings are deleted for good; what was made of them stays, but cannot be done again.', (item) => `/captures/${item.id}`),
  ];
};

export const forJobs = (context) => (items) => {
  const over = items.filter(ended), active = items.filter((item) => !ended(item));
  const cancel = () => outcome('jobs', active, 'cancelled', () => each(active, (item) => post(`/jobs/${item.id}/cancel`))).catch((error) => complain(error.message));
  return [
    exporting(items.filter((item) => item.type === 'reconstruct' && item.status === 'done'), context),
    offer('Cancel', 'cancel-jobs', active, cancel, { asks: false }),
    removal('jobs', over, `${made(over)} of results`, 'The jobs, their logs and everything they made are deleted for good. Their captures stay.', (item) => `/jobs/${item.id}`),
  ];
};
