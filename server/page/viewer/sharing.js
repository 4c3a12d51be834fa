// A view as a link and as a picture. The link's fragment has instant_s, speed, depth, cameras and compare, and either
// camera=ID or pose=centre,turn(xyzw),target with lens=ID; what is left out is as the page begins.
import { element } from '../operator/dom.js';
import { fit } from './view.js';

const SWITCH = { on: true, off: false };
const POSE = 10; // numbers of a free view: centre and target in m, a unit quaternion
const UNIT = 1e-3; // how far a quaternion's length may be off

export class LinkError extends Error {}

function bad(name, found, expected) {
  throw new LinkError(`${name}: found ${found.slice(0, 60)}, expected ${expected}`);
}

/** Return the fragment of a state {camera or pose and lens, instant_s, speed, depth, cameras, compare}. */
export function fragment({ camera, pose, lens, compare, depth, cameras, ...numbers }) {
  const word = (on) => (on ? 'on' : 'off');
  const place = camera ? { camera } : { pose: pose.join(','), lens };
  return new URLSearchParams({ ...place, ...numbers, depth: word(depth), cameras: word(cameras), ...(compare !== null && { compare }) }).toString().replaceAll('%2C', ',');
}

const number = (name, low, high) => (text) => {
  const value = text.trim() === '' ? NaN : Number(text);
  return value >= low && value <= high ? value : bad(name, text, `a number from ${low} to ${high}`);
};
const one = (name, words) => (text) => (words.includes(text) ? text : bad(name, text, `one of ${words.join(', ')}`));
const flag = (name) => (text) => (text in SWITCH && Object.hasOwn(SWITCH, text) ? SWITCH[text] : bad(name, text, 'on or off'));

function poseOf(text) {
  const values = text.split(',').map((part) => (part.trim() === '' ? NaN : Number(part)));
  const whole = values.length === POSE && values.every(Number.isFinite);
  if (!whole || Math.abs(Math.hypot(...values.slice(3, 7)) - 1) > UNIT) bad('pose', text, `${POSE} numbers, the fourth to seventh a rotation`);
  if (values.slice(0, 3).every((value, axis) => value === values[7 + axis])) bad('pose', text, 'a target away from the centre');
  return values;
}

/** Read a fragment: the members that it has. Throws LinkError for any that cannot be. */
export function stateOf(text, { cameras, clip_s: [first, last] }, speeds) {
  const ids = cameras.map(({ id }) => id);
  const readers = {
    camera: one('camera', ids), pose: poseOf, lens: one('lens', ids), instant_s: number('instant_s', first, last),
    speed: one('speed', speeds), depth: flag('depth'), cameras: flag('cameras'), compare: number('compare', 0, 1),
  };
  const state = {};
  for (const [name, value] of new URLSearchParams(text)) {
    if (!Object.hasOwn(readers, name)) bad('link', name, `one of ${Object.keys(readers).join(', ')}`);
    state[name] = readers[name](value);
  }
  if ('pose' in state !== 'lens' in state || ('pose' in state && 'camera' in state)) bad('link', text, 'a camera, or pose and lens');
  return state;
}

/** Return the place of a View, as `fragment` takes it. */
export function placeOf({ camera, centre, turn, target, lens }) {
  return camera ? { camera: camera.id } : { pose: [...centre.toArray(), ...turn.toArray(), ...target.toArray()], lens: lens.id };
}

/** Put a View into a place that `placeOf` told. */
export function restore(view, { camera, pose, lens }) {
  view.enter(view.cameras.find(({ id }) => id === (camera ?? lens)));
  if (camera) return;
  view.camera = null;
  view.centre.fromArray(pose);
  view.turn.fromArray(pose, 3);
  view.target.fromArray(pose, 7);
}

/** Return the name of a picture's file: job, camera or free, instant in ms from the clip's start, what is shown. */
export function fileName(job, camera, ms, shown) {
  const parts = [job, camera?.id ?? 'free', `${ms.toFixed(2)}ms`, ...shown];
  return `${parts.join('-').replace(/[^\p{L}\p{N}._-]+/gu, '_').replace(/^[._]+/, '').slice(0, 150)}.png`;
}

/** Return a canvas with what the drawn `canvas` shows and, left of its wipe, the camera's picture. */
export function composed(canvas, view, size, { visible, canvas: shot, share }) {
  const made = element('canvas', { width: canvas.width, height: canvas.height });
  const context = made.getContext('2d');
  context.drawImage(canvas, 0, 0);
  if (!visible) return made;
  const { scale, left, top } = fit(view.camera, size);
  const px = canvas.width / size.width;
  const [x, y, width, height] = [left, top, scale * view.camera.width, scale * view.camera.height].map((css) => css * px);
  context.drawImage(shot, 0, 0, share * shot.width, shot.height, x, y, share * width, height);
  context.fillStyle = '#fff';
  context.fillRect(x + share * width - px, y, 2 * px, height);
  return made;
}

/** Offer a canvas to be saved as PNG. */
export async function save(canvas, name) {
  const blob = await new Promise((done) => { canvas.toBlob(done, 'image/png'); });
  const url = URL.createObjectURL(blob);
  element('a', { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}
