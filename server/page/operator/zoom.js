// Pictures opened large: fitted to the window or larger, moved by dragging, scrolling or keys.
import { byId, element } from './dom.js';
import { control, openLarge } from './large.js';
import { setSource } from './media.js';

const TIMES = 1.5, MOST = 8;

class Zoom {
  constructor(pictures) {
    Object.assign(this, { pictures, at: 0, scale: 1 });
    this.name = element('p', { className: 'quiet', id: 'large-name', ariaLive: 'polite' });
    this.image = element('img', { id: 'large-picture', onload: () => this.begin() });
    this.pane = element('div', { id: 'large-pane', className: 'pane', tabIndex: 0 }, this.image);
    this.pane.onpointerdown = (event) => this.drag(event);
    this.pane.ondblclick = () => this.set(this.scale > this.fit ? this.fit : this.fit * TIMES * TIMES);
  }

  show(at) {
    this.at = (at + this.pictures.length) % this.pictures.length;
    const { path, label } = this.pictures[this.at];
    this.name.textContent = this.pictures.length > 1 ? `${this.at + 1} of ${this.pictures.length}: ${label}` : '';
    this.image.alt = label;
    this.pane.ariaLabel = label;
    setSource(this.image, path);
    return true;
  }

  get fit() {
    const { naturalWidth, naturalHeight } = this.image;
    return Math.min(this.pane.clientWidth / naturalWidth, this.pane.clientHeight / naturalHeight);
  }

  // At least its own size, so that its words can be read on a telephone, too.
  begin() {
    this.set(Math.max(1, this.fit));
    this.pane.scrollTo(0, 0);
  }

  set(scale) {
    const { pane, image } = this;
    const middle = [(pane.scrollLeft + pane.clientWidth / 2) / this.scale, (pane.scrollTop + pane.clientHeight / 2) / this.scale];
    this.scale = Math.min(MOST, Math.max(Math.min(1, this.fit), scale));
    image.style.width = `${image.naturalWidth * this.scale}px`;
    pane.scrollTo(middle[0] * this.scale - pane.clientWidth / 2, middle[1] * this.scale - pane.clientHeight / 2);
    byId('large-smaller').disabled = this.scale <= Math.min(1, this.fit);
    return true;
  }

  drag(event) {
    if (event.pointerType !== 'mouse' || event.button) return; // fingers scroll
    const { pane } = this;
    const from = [event.clientX + pane.scrollLeft, event.clientY + pane.scrollTop];
    event.preventDefault();
    pane.focus();
    pane.setPointerCapture(event.pointerId);
    pane.onpointermove = (moved) => pane.scrollTo(from[0] - moved.clientX, from[1] - moved.clientY);
    pane.onpointerup = () => { pane.onpointermove = null; };
  }

  key(name) {
    if (name === '+' || name === '=') return this.set(this.scale * TIMES);
    if (name === '-') return this.set(this.scale / TIMES);
    if (name === '0') return this.set(this.fit);
    const step = { ArrowLeft: -1, ArrowRight: 1 }[name];
    const moves = this.pane.scrollWidth > this.pane.clientWidth; // then the arrows do that
    return Boolean(step) && this.pictures.length > 1 && !moves && this.show(this.at + step);
  }
}

// Open the first of some pictures, each {path, label}; the others are a key away.
export function openPictures(heading, pictures) {
  const view = new Zoom(pictures);
  const steps = pictures.length > 1 ? [control('Previous', 'large-previous', () => view.show(view.at - 1)), control('Next', 'large-next', () => view.show(view.at + 1))] : [];
  const made = openLarge('pictures', heading, [...steps,
    Object.assign(control('−', 'large-smaller', () => view.key('-')), { ariaLabel: 'Smaller' }),
    control('Fit', 'large-fit', () => view.key('0')),
    Object.assign(control('+', 'large-larger', () => view.key('+')), { ariaLabel: 'Larger' })],
  element('div', { className: 'large-body' }, view.name, view.pane), { keys: (name) => view.key(name) });
  view.pane.focus();
  view.show(0);
  return made;
}
