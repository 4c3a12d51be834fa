// Fetches viewer.json and viewer.bin of a job and checks that they fit together.
import { request } from '../operator/api.js';
import { artefact } from '../operator/media.js';

const VERSION = 1;
const OPTIONAL = ['accelerations', 'jerks', 'key_scales'];
const MOTIONS = ['static', 'polynomial', 'keyframes'];

export class SceneError extends Error {}

/** Return the scene of a job: {manifest, arrays}, each array a Float32Array. Throws SceneError. */
export async function loadScene(job, progress = () => {}) {
  const manifest = await (await fetched(job, 'viewer.json')).json().catch(() => fault('no JSON', 'a manifest'));
  checkManifest(manifest);
  const bytes = await download(await fetched(job, 'viewer.bin'), progress);
  return { manifest, arrays: arraysOf(manifest, bytes) };
}

async function fetched(job, name) {
  try {
    return await request(artefact(encodeURIComponent(job), name));
  } catch (error) {
    if (error.status === 401) throw new SceneError('The service asks for a token; enter it on the first page.');
    throw new SceneError(error.status ? `Job ${job} has no ${name} to show: ${error.message}` : error.message);
  }
}

async function download(response, progress) {
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
    throw new SceneError(`viewer.bin: found ${received} bytes and a broken connection (${error.message}); reload`);
  }
  return new Blob(parts).arrayBuffer();
}

function fault(found, expected, name = 'viewer.json') {
  throw new SceneError(`${name}: found ${found}, expected ${expected}; export the job again`);
}

function checkManifest(manifest) {
  if (manifest?.version !== VERSION) fault(`version ${manifest?.version}`, VERSION);
  if (!MOTIONS.includes(manifest.motion)) fault(`motion ${manifest.motion}`, MOTIONS.join(', '));
  const { count, still, moving, clip_s: clip, cameras, centre, depth_m: depth } = manifest;
  if (![count, still, moving].every((n) => Number.isInteger(n) && n >= 0) || still + moving !== count || count === 0) {
    fault(`${still} still and ${moving} moving Gaussians of ${count}`, 'counts that add up to one or more');
  }
  if (!numbers(clip, 2) || clip[1] < clip[0]) fault(`clip_s ${clip}`, 'its first and last second');
  if (!numbers(depth, 2) || !(depth[0] > 0) || !(depth[1] > depth[0])) fault(`depth_m ${depth}`, 'near and far in m');
  if (!numbers(centre, 3)) fault(`centre ${centre}`, 'three numbers');
  if (!Array.isArray(cameras) || cameras.length === 0 || !cameras.every(isCamera)) {
    fault('cameras that cannot be used', 'size, fx fy cx cy and cam_from_rig of each');
  }
}

const numbers = (list, length) => Array.isArray(list) && list.length === length && list.every(Number.isFinite);

const isCamera = (camera) => numbers([camera.fx, camera.fy, camera.cx, camera.cy], 4)
  && camera.width > 0 && camera.height > 0 && numbers([camera.cam_from_rig].flat(2), 16);

/** Return the shapes of the arrays that a manifest lists. */
function shapesOf({ count, moving, motion, keyframes }) {
  const stored = { means: [count, 3], quats_wxyz: [count, 4], scales: [count, 3], opacities: [count], intensities: [count] };
  const vector = [moving, 3];
  if (moving === 0 || motion === 'static') return stored;
  if (motion === 'polynomial') return { ...stored, velocities: vector, accelerations: vector, jerks: vector, instants: [moving], durations: [moving] };
  const keys = { key_means: [keyframes, moving, 3], key_quats: [keyframes, moving, 4], key_opacities: [keyframes, moving], key_scales: [keyframes, moving, 3] };
  return { ...stored, ...keys };
}

function arraysOf(manifest, bytes) {
  const arrays = {};
  for (const [name, shape] of Object.entries(shapesOf(manifest))) {
    const entry = manifest.arrays?.[name];
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
  return new Float32Array(bytes, entry.offset, length);
}
