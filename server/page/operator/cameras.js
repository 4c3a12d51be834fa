// The pictures of an array's cameras, large: all in their places, or one alone, with focus and light.
import { get, rigPath } from './api.js';
import { byId, element } from './dom.js';
import { control, isLarge, openLarge } from './large.js';
import { histogram, percent } from './light.js';
import { setSource } from './media.js';

const WORRYING = { over: 0.01, under: 0.5 }; // shares of pixels
const MEANING = 'Focus: the variance of the Laplacian over the square of the mean light, in thousandths; compare a camera with itself. '
  + 'Over: pixels that fire every tick. Under: pixels that never fired.';
const STEPS = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };

const rounded = (focus) => (focus >= 100 ? focus.toFixed(0) : focus.toPrecision(3));
const line = (className, ...text) => element('span', { className }, ...text);
const share = (word, name, value) => line(value > WORRYING[name] ? 'failed' : '', `${word} ${percent(value)}`);

function figures(one, best) {
  if (one.focus === null) return [line('failed', 'no plane')];
  const label = `Focus of ${one.id}, of the best so far`;
  return [
    line('focus', `Focus ${rounded(one.focus)}`),
    line('quiet', best > 0 ? `${Math.floor((100 * one.focus) / best)} % of the best` : 'nothing to focus on'),
    element('meter', { min: 0, max: best || 1, value: one.focus, ariaLabel: label }),
    share('Over', 'over', one.over),
    share('Under', 'under', one.under),
    histogram(one.histogram, `Light of ${one.id}: ${percent(one.over)} of the pixels are overexposed, ${percent(one.under)} underexposed`),
    line('quiet ends', line('', 'dark'), line('', 'a spike every tick')),
    line('quiet more', `Mean light ${one.mean.toFixed(3)} spikes per tick, from ${one.planes} planes of ${one.width} × ${one.height}`),
    line('quiet more', MEANING),
  ];
}

// A camera's cell, whose picture and figures `shown` renews.
function cell(one, number, choose) {
  const picture = element('img', { alt: `What ${one.id} sees`, decoding: 'async' });
  const told = line('told');
  const made = element('button', { type: 'button', id: `cell-${one.id}`, className: 'cell', onclick: () => choose(one.id) },
    picture, line('about', line('name', number < 9 ? element('kbd', {}, `${number + 1}`) : null, ` ${one.id}`), told));
  made.style.gridArea = `${one.row + 1} / ${one.column + 1}`;
  const shown = (path, found, best) => {
    setSource(picture, path);
    told.replaceChildren(...figures(found, best));
  };
  return { made, shown, place: [one.row, one.column] };
}

class Cameras {
  constructor(learn, path) {
    Object.assign(this, { learn, path, cells: new Map(), best: new Map(), chosen: null });
    this.fault = element('p', { className: 'failed', role: 'alert' });
    this.age = element('p', { className: 'quiet', id: 'large-age' });
    this.grid = element('div', { className: 'cells', id: 'cells' });
  }

  async show() {
    try {
      this.found = await this.learn();
      this.fault.textContent = '';
    } catch (error) {
      this.fault.textContent = error.message;
      return;
    }
    this.age.textContent = this.found.age_s === undefined ? '' : `Seen at ${new Date(Date.now() - 1000 * this.found.age_s).toLocaleTimeString()}`;
    const known = this.found.cameras.map((one) => one.id).join();
    if (known !== [...this.cells.keys()].join()) this.fill();
    this.renew();
  }

  fill() {
    const choose = (id) => this.choose(this.chosen === id ? null : id);
    this.cells = new Map(this.found.cameras.map((one, i) => [one.id, cell(one, i, choose)]));
    this.grid.style.setProperty('--columns', 1 + Math.max(...this.found.cameras.map((one) => one.column)));
    this.grid.replaceChildren(...[...this.cells.values()].map(({ made }) => made));
    this.cells.values().next().value?.made.focus();
  }

  renew() {
    for (const one of this.found.cameras) {
      this.best.set(one.id, Math.max(one.focus ?? 0, this.best.get(one.id) ?? 0));
      this.cells.get(one.id).shown(this.path(one.id, this.found.etag), one, this.best.get(one.id));
    }
  }

  forget() {
    this.best.clear();
    if (this.found) this.renew();
  }

  // Show one camera alone, or all for null.
  choose(id) {
    const before = this.chosen;
    this.chosen = id;
    this.grid.classList.toggle('alone', id !== null);
    byId('large-back').hidden = id === null;
    for (const [name, { made }] of this.cells) {
      made.classList.toggle('only', name === id);
      made.ariaPressed = String(name === id);
    }
    this.cells.get(id ?? before)?.made.focus();
    return before !== id;
  }

  key(name) {
    const ids = [...this.cells.keys()];
    if (/^[1-9]$/.test(name) && ids[name - 1]) return this.choose(ids[name - 1]) || true;
    if (!(name in STEPS)) return false;
    const at = this.chosen ?? ids.find((id) => this.cells.get(id).made === document.activeElement) ?? ids[0];
    const next = this.beside(at, STEPS[name]);
    if (this.chosen === null) this.cells.get(next)?.made.focus();
    else this.choose(next);
    return true;
  }

  // The camera beside another; left and right go on in the next row.
  beside(id, [down, right]) {
    const ids = [...this.cells.keys()];
    if (right) return ids[(ids.indexOf(id) + right + ids.length) % ids.length];
    const [row, column] = this.cells.get(id).place;
    return ids.find((one) => this.cells.get(one).place.join() === [row + down, column].join()) ?? id;
  }
}

function open(key, heading, learn, path, controls, moment) {
  const view = new Cameras(learn, path);
  const back = Object.assign(control('All cameras', 'large-back', () => view.choose(null), 'Escape'), { hidden: true });
  const forget = control('Forget the best', 'large-forget', () => view.forget(), 'Begin a new comparison of focus');
  let at = moment?.();
  const refresh = moment && (() => {
    if (moment() === at) return;
    at = moment();
    view.show();
  });
  openLarge(key, heading, [...controls, moment ? forget : null, back].filter(Boolean), element('div', { className: 'large-body' }, view.age, view.fault, view.grid),
    { keys: (name) => view.key(name), back: () => view.chosen !== null && view.choose(null), refresh });
  view.show();
}

const lookKey = (rig) => `look-${rig}`;
export const isFocusing = (rig) => isLarge(lookKey(rig));

// The last look of a rig; while the page looks again and again, the view follows.
export function openLook(rig, context) {
  const live = byId(`live-${rig.id}`), mine = element('input', { type: 'checkbox', id: 'large-live', checked: live?.checked });
  mine.onchange = () => {
    live.checked = mine.checked;
    context.watch(rig.id, mine.checked);
  };
  open(lookKey(rig.id), `What the cameras of ${rig.name} see`, () => get(`${rigPath(rig.id)}/look`), (camera, etag) => `/v1${rigPath(rig.id)}/look/${camera}?of=${encodeURIComponent(etag)}`,
    live ? [element('label', { className: 'check' }, mine, 'Live')] : [], () => context.statuses.get(rig.id)?.look?.etag);
}

export function openCapture(capture) {
  open(`capture-${capture.id}`, `What the cameras of ${capture.name ?? capture.id} saw`, () => get(`/captures/${capture.id}/figures`), (camera) => `/v1/captures/${capture.id}/preview/${camera}`, []);
}
