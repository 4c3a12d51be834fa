// Captures: their recordings, their losses, and the jobs they can be used for.
import { post, rigPath } from './api.js';
import { actions, asking, button, removal } from './act.js';
import { calibrating } from './calibrations.js';
import { openCapture } from './cameras.js';
import { bar, card, element, failure, fold, quiet, title, when } from './dom.js';
import { labelling, note } from './labels.js';
import { enlarging } from './media.js';
import { ended } from './results.js';
import { box } from './selection.js';
import { inWords } from './words.js';

function length(item, context) {
  if (item.ticks === null) return item.type === 'import' ? 'imported' : 'until stopped';
  const rate = context.rigs.get(item.rig)?.tick_rate_hz;
  return rate ? `${item.ticks} ticks, ${((item.ticks / rate) * 1000).toFixed(1)} ms` : `${item.ticks} ticks`;
}

// List the faults of a recording: why it is incomplete, planes lost by layer over all cameras, and later damage.
export function lacks(manifest) {
  const lost = {};
  for (const { drops } of manifest.cameras) {
    for (const [layer, planes] of Object.entries(drops)) lost[layer] = (lost[layer] ?? 0) + planes;
  }
  const drops = Object.entries(lost).filter(([, planes]) => planes).map(([layer, planes]) => `${planes} planes lost (${layer})`);
  const damages = manifest.verified?.sound === false ? ['damaged since it was written'] : [];
  return [...(manifest.reason ? [`incomplete: ${manifest.reason}`] : []), ...drops, ...damages];
}

function state(item, context) {
  const manifest = context.manifests.get(item.id);
  if (!manifest) return null;
  if (manifest.fault) return failure(`What it holds cannot be told: ${manifest.fault}`);
  const missing = lacks(manifest);
  const skews = manifest.cameras.map((camera) => camera.skew_s).filter((skew) => skew !== null);
  const skew = skews.length ? `skew up to ${(Math.max(...skews.map(Math.abs)) * 1e6).toFixed(1)} µs` : null;
  const sound = manifest.verified?.sound ? 'every byte verified' : null;
  return [
    missing.length > 0 && failure(missing.join('; ')),
    quiet([missing.length ? null : 'No plane lost', skew, sound].filter(Boolean).join(', ')),
  ];
}

function running(item, context) {
  if (ended(item)) return null;
  const path = `${rigPath(item.rig)}/captures/${item.id}`;
  return element('div', {},
    item.status === 'running' && bar(`${item.id}: ${item.stage ?? 'starting'}`, item.fraction),
    item.message && element('p', {}, item.message),
    item.type === 'record' && actions(
      button('Stop', `stop-${item.id}`, () => post(`${path}/stop`), { plain: false, done: 'The recording ends' }),
      item.pre_trigger_ms !== null && button('Save from the pre-trigger', `save-${item.id}`, () => post(`${path}/save`), { done: 'What was kept is saved' }),
      asking('Reconstruct meanwhile…', `Reconstruct ${item.name ?? item.id} while it is recorded`, 'reconstruct', { capture: item.id, follow: true }, item, context)));
}

function offered(item, context) {
  const label = labelling(item, `/captures/${item.id}`);
  if (!ended(item)) return fold(`more-${item.id}`, 'More', actions(label));
  const ask = (label, verb, type, plain) => asking(label, `${verb} ${item.name ?? item.id}`, type, { capture: item.id }, item, context, plain);
  const verify = () => post('/jobs', { type: 'verify', capture: item.id });
  const more = element('div', {}, actions(
    item.status === 'done' && [
      calibrating(`Calibrate ${item.rig} from ${item.name ?? item.id}`, item, item.rig, [item.id], context),
      ask('Check rig…', 'Check the rig against', 'check-rig'),
      ask('Images…', 'Images of', 'images'),
      button('Verify', `verify-${item.id}`, verify, { done: 'The check of every byte is queued' }),
    ],
    label,
    removal(item, `/captures/${item.id}`, 'The recording is deleted for good; what was made of it stays, but cannot be done again.')));
  const finalise = () => post(`/captures/${item.id}/finalise`);
  return [
    item.partial_planes > 0 && actions(button(
      `Finalise ${item.partial_planes} planes`, `finalise-${item.id}`, finalise, { plain: false, done: 'What was kept becomes a recording' })),
    item.status === 'done' && actions(ask('Reconstruct…', 'Reconstruct', 'reconstruct', false)),
    fold(`more-${item.id}`, 'More', more),
  ];
}

export function capture(item, context) {
  return card(`capture-${item.id}`,
    title(item.name ?? item.id, item.status, item.status === 'running' && item.type === 'record' ? 'recording' : item.status, box('captures', item)),
    quiet([when(item.created), item.rig, length(item, context), item.name && item.id].filter(Boolean).join(' · ')),
    item.status === 'done' && enlarging(`/v1/captures/${item.id}/preview`, `What the cameras of ${item.name ?? item.id} saw`, 'preview', () => openCapture(item)),
    note(item),
    state(item, context),
    failure(inWords(item.error)),
    item.status === 'cancelled' && item.message && quiet(item.message),
    running(item, context),
    offered(item, context));
}
