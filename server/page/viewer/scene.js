// Fetches viewer.json and viewer.bin of a job, whole or span by span, and checks that they fit together.
import { request } from '../operator/api.js';
import { artefact } from '../operator/media.js';

const [VERSION, SPANNED_VERSION] = [1, 2];
const OPTIONAL = ['accelerations', 'jerks', 'key_scales', 'key_intensities'];
const MOTIONS = ['static', 'polynomial', 'keyframes'];
const [SPANNED_MOTIONS, WHOLE_NUMBERS] = [[...MOTIONS, 'bodies'], ['changed', 'bodies']];

export class SceneError extends Error {}

/**
 * Return the scene of a job: {manifest, arrays}, each array a Float32Array. Throws SceneError.
 * A scene of spans has the arrays of still Gaussians, and beside them `job` and the `tag` of viewer.bin.
 */
export async function loadScene(job, progress = () => {}) {
  const manifest = await (await fetched(job, 'viewer.json')).json().catch(() => fault('no JSON', 'a manifest'));
  checkManifest(manifest);
  if (manifest.spans) return loadStill(job, manifest, progress);
  const bytes = await download(await fetched(job, 'viewer.bin'), progress);
  return { manifest, arrays: arraysOf(manifest, bytes) };
}

async function loadStill(job, manifest, progress) {
  const shapes = { ...manifest, count: manifest.still, moving: 0 };
  const length = Math.min(...manifest.spans.map(({ offset }) => offset));
  const { bytes, tag } = await downloadRange(job, { offset: 0, length }, { progress });
  return { manifest, arrays: arraysOf(shapes, bytes), job, tag };
}

/** Return span `number` of a scene as a scene of its movers, with what it `changed`. Throws SceneError, or AbortError. */
export async function loadSpan({ manifest: { spans, still }, job, tag }, number, { signal, progress }) {
  const span = spans[number];
  const manifest = { ...span, count: span.moving, still: 0 };
  const { bytes } = await downloadRange(job, span, { signal, progress, tag });
  const arrays = arraysOf(manifest, bytes, { ...changesOf(span), ...(span.moving > 0 && shapesOf(manifest)) });
  if (arrays.changed?.some((index) => index >= still)) fault('a changed Gaussian beyond the still ones', `${still} of them`);
  return { manifest, arrays };
}

/** Return the bytes of a range of viewer.bin and the file's tag, which must be `tag` where there is one. */
async function downloadRange(job, { offset, length }, { signal, progress = () => {}, tag }) {
  if (length === 0) return { bytes: new ArrayBuffer(0), tag };
  const response = await fetched(job, 'viewer.bin', { signal, headers: { Range: `bytes=${offset}-${offset + length - 1}` } });
  const found = response.headers.get('ETag');
  if (response.status !== 206 || (tag && found !== tag)) {
    await response.body.cancel();
    throw new SceneError(`viewer.bin: found ${tag && found !== tag ? 'another one than before; reload' : 'a server without ranges'}`);
  }
  const bytes = await download(response, progress, '');
  if (bytes.byteLength !== length) fault(`${bytes.byteLength} bytes at ${offset}`, `${length}`, 'viewer.bin');
  return { bytes, tag: found };
}

async function fetched(job, name, options) {
  try {
    return await request(artefact(encodeURIComponent(job), name), options);
  } catch (error) {
    if (error.name === 'AbortError') throw error;
    if (error.status === 401) throw new SceneError('The service asks for a token; enter it on the first page.');
    throw new SceneError(error.status ? `Job ${job} has no ${name} to show: ${error.message}` : error.message);
  }
}

async function download(response, progress, advice = '; reload') {
  const total = Number(response.headers.get('Content-Length')) || 0;
  const parts = [];
  let received = 0;
  const reader = response.body.getReader();
  try {
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      parts.push(part.value);
      received += part.value.length;
      progress(received, total);
    }
  } catch (error) {
    if (error.name === 'AbortError') throw error;
    throw new SceneError(`viewer.bin: found ${received} bytes and a broken connection (${error.message})${advice}`);
  }
  return new Blob(parts).arrayBuffer();
}

function fault(found, expected, name = 'viewer.json') {
  throw new SceneError(`${name}: found ${found}, expected ${expected}; export the job again`);
}

function checkManifest(manifest) {
  const expected = manifest?.spans ? SPANNED_VERSION : VERSION;
  if (manifest?.version !== expected) fault(`version ${manifest?.version}`, expected);
  if (manifest.spans) checkSpans(manifest);
  else if (!MOTIONS.includes(manifest.motion)) fault(`motion ${manifest.motion}`, MOTIONS.join(', '));
  const { count, still, moving, clip_s: clip, cameras, centre, depth_m: depth, dilation_px2: dilation } = manifest;
  if (![count, still, moving].every((n) => Number.isInteger(n) && n >= 0) || still + moving !== count || count === 0) {
    fault(`${still} still and ${moving} moving Gaussians of ${count}`, 'counts that add up to one or more');
  }
  if (!numbers(clip, 2) || clip[1] < clip[0]) fault(`clip_s ${clip}`, 'its first and last second');
  if (!numbers(depth, 2) || !(depth[0] > 0) || !(depth[1] > depth[0])) fault(`depth_m ${depth}`, 'near and far in m');
  if (!numbers(centre, 3)) fault(`centre ${centre}`, 'three numbers');
  if (dilation !== undefined && !(numbers([dilation], 1) && dilation > 0)) fault(`dilation_px2 ${dilation}`, 'a number above 0');
  if (!Array.isArray(cameras) || cameras.length === 0 || !cameras.every(isCamera)) {
    fault('cameras that cannot be used', 'size, fx fy cx cy and cam_from_rig of each');
  }
}

function checkSpans({ spans, moving }) {
  if (!Array.isArray(spans) || spans.length === 0 || !spans.every(isSpan)) {
    fault('spans that cannot be used', 'first_s, last_s, clip_s, offset, length and counts of each');
  }
  if (!spans.every(({ first_s: first }, k) => k === 0 || spans[k - 1].first_s < first)) fault('spans in disorder', 'them in order of time');
  if (spans.reduce((sum, span) => sum + span.moving, 0) !== moving) fault(`${moving} moving Gaussians`, 'as many as in all spans');
}

const isSpan = (span) => numbers([span.first_s, span.last_s, ...(span.clip_s ?? [])], 4) && SPANNED_MOTIONS.includes(span.motion)
  && [span.offset, span.length, span.changed, span.moving, ...(span.motion === 'bodies' ? [span.bodies, span.knots] : [])]
    .every((n) => Number.isInteger(n) && n >= 0);

const numbers = (list, length) => Array.isArray(list) && list.length === length && list.every(Number.isFinite);

const isCamera = (camera) => numbers([camera.fx, camera.fy, camera.cx, camera.cy], 4)
  && camera.width > 0 && camera.height > 0 && numbers([camera.cam_from_rig].flat(2), 16);

/** Return the shapes of the arrays that a manifest lists. */
function shapesOf({ count, moving, motion, keyframes, bodies, knots }) {
  const stored = { means: [count, 3], quats_wxyz: [count, 4], scales: [count, 3], opacities: [count], intensities: [count] };
  const vector = [moving, 3];
  if (moving === 0 || motion === 'static') return stored;
  const windows = { velocities: vector, instants: [moving], durations: [moving] };
  if (motion === 'polynomial') return { ...stored, ...windows, accelerations: vector, jerks: vector };
  if (motion === 'bodies') return { ...stored, ...windows, bodies: [moving], knot_quats: [bodies, knots, 4], knot_centers: [bodies, knots, 3] };
  const [single, triple] = [[keyframes, moving], [keyframes, moving, 3]];
  const keys = { key_means: triple, key_quats: [keyframes, moving, 4], key_opacities: single, key_scales: triple, key_intensities: single };
  return { ...stored, ...keys };
}

const changesOf = ({ changed }) => (changed > 0 ? { changed: [changed], changed_opacities: [changed], changed_intensities: [changed] } : {});

function arraysOf(manifest, bytes, shapes = shapesOf(manifest)) {
  const arrays = {};
  for (const [name, shape] of Object.entries(shapes)) {
    const place = manifest.arrays?.[name]; // a span says where an array begins and no more
    const entry = Number.isInteger(place) ? { offset: place, shape, dtype: 'float32' } : place;
    if (entry) arrays[name] = view(name, entry, shape, bytes);
    else if (!OPTIONAL.includes(name)) fault(`no array ${name}`, 'one');
  }
  return arrays;
}

function view(name, entry, shape, bytes) {
  const fits = entry.dtype === 'float32' && String(entry.shape) === String(shape) && entry.offset % 4 === 0 && entry.offset >= 0;
  if (!fits) fault(`${name} ${entry.dtype} [${entry.shape}] at ${entry.offset}`, `float32 [${shape}]`);
  const length = shape.reduce((product, n) => product * n, 1);
  const end = entry.offset + 4 * length;
  if (end > bytes.byteLength) fault(`${bytes.byteLength} bytes`, `${end} or more for ${name}`, 'viewer.bin');
  return new (WHOLE_NUMBERS.includes(name) ? Uint32Array : Float32Array)(bytes, entry.offset, length);
}
