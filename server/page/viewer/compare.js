// In a camera's own view: the picture that it took at the instant shown, wiped over the render.
import { get, request } from '../operator/api.js';
import { byId } from '../operator/dom.js';
import { fit } from './view.js';

const MOST_KEPT = 400; // pictures in this browser
const PLAYED = 50; // pictures of a span while the clip plays

export class Compare {
  /** `job` is its id, `clip` its first and last second, in so many spans; `changed` is called when a frame is due. */
  constructor(job, clip, spans, changed) {
    Object.assign(this, { job: encodeURIComponent(job), clip, spans, changed, wanted: false, about: null, fault: '' });
    this.canvas = byId('shot');
    this.kept = new Map(); // "camera/plane" to a bitmap
    this.shown = null; // what the canvas has
    this.asking = null;
  }

  get share() { return Number(byId('wipe').value) / 100; }

  set share(value) { byId('wipe').value = Math.round(100 * value); }

  /** Switch the comparison on or off. */
  async want(on) {
    Object.assign(this, { wanted: on, fault: '' });
    byId('compare').ariaPressed = on;
    if (on && !this.about) {
      this.about = await get(`/jobs/${this.job}/pictures`).catch((error) => { this.fault = error.message; return null; });
    }
    this.changed();
  }

  /** Put the camera's picture over the render; `u` is the time shown. */
  place(view, size, u, running) {
    const { camera } = view;
    byId('compare').disabled = !camera;
    const on = this.wanted && camera && this.about?.cameras.includes(camera.id);
    if (on) this.#choose(camera.id, this.#plane(u, running));
    this.visible = Boolean(on && this.shown?.camera === camera.id);
    this.canvas.hidden = byId('edge-of-shot').hidden = !this.visible;
    byId('wiping').hidden = !on;
    byId('compared').textContent = this.#words(camera, on);
    if (!this.visible) return;
    const { scale, left, top } = fit(camera, size);
    const [width, height] = [scale * camera.width, scale * camera.height];
    Object.assign(this.canvas.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px` });
    this.canvas.style.clipPath = `inset(0 ${100 * (1 - this.share)}% 0 0)`;
    Object.assign(byId('edge-of-shot').style, { left: `${left + this.share * width - 1}px`, top: `${top}px`, height: `${height}px` });
    byId('wipe').ariaValueText = `${Math.round(100 * this.share)} % picture, the rest render`;
  }

  #words(camera, on) {
    if (!camera) return 'Choose a camera under View to compare with its picture.';
    if (!this.wanted && !this.fault) return '';
    if (this.fault) return `No picture to compare with: ${this.fault}`;
    if (!on) return this.about ? `No picture of ${camera.id} is kept.` : '';
    if (!this.visible) return 'Loading the picture';
    const ms = (1000 * (this.#instant(this.shown.plane) - this.clip[0])).toFixed(2);
    return `Left: ${camera.id}'s picture at ${ms} ms, reconstructed from spikes by ${this.about.method}, not the truth. Right: the render.`;
  }

  #instant(plane) { return (plane + 0.5) / this.about.tick_rate_hz; }

  /** Return the plane nearest to u; while the clip runs one of few, so that all are soon here. */
  #plane(u, running) {
    const [first, last] = this.clip;
    const rate = this.about.tick_rate_hz;
    const step = running ? Math.max(1, Math.ceil((last - first) * rate / this.spans / PLAYED)) : 1;
    const plane = Math.floor((first + u * (last - first)) * rate + 1e-6);
    return Math.min(Math.max(Math.floor(plane / step) * step, 0), this.about.planes - 1);
  }

  #choose(camera, plane) {
    const bitmap = this.kept.get(`${camera}/${plane}`);
    if (bitmap) this.#show(camera, plane, bitmap);
    else if (!this.asking) this.#ask(camera, plane);
  }

  #show(camera, plane, bitmap) {
    if (this.shown?.camera === camera && this.shown.plane === plane) return;
    Object.assign(this.canvas, { width: bitmap.width, height: bitmap.height });
    this.canvas.getContext('2d').drawImage(bitmap, 0, 0);
    this.shown = { camera, plane };
    this.canvas.dataset.plane = plane;
  }

  // One request after another, so that a moving slider asks for what it shows and no more.
  async #ask(camera, plane) {
    this.asking = `${camera}/${plane}`;
    try {
      const answer = await request(`/v1/jobs/${this.job}/pictures/${camera}?plane=${plane}`);
      this.#keep(this.asking, await createImageBitmap(await answer.blob()));
      this.fault = '';
    } catch (error) {
      this.fault = error.message;
      this.wanted = false;
      byId('compare').ariaPressed = false;
    }
    this.asking = null;
    this.changed();
  }

  #keep(key, bitmap) {
    this.kept.set(key, bitmap);
    if (this.kept.size <= MOST_KEPT) return;
    const [oldest, gone] = this.kept.entries().next().value;
    this.kept.delete(oldest);
    gone.close();
  }
}
