// Elements are made anew from the state and merged into those on the page: focus, typed text, open details and
// playing videos stay as they are.
const HANDLERS = ['onclick', 'onchange', 'oninput', 'onsubmit', 'ontoggle'];
const SVG = 'http://www.w3.org/2000/svg';
const OWN = { DETAILS: ['open'], INPUT: ['value', 'disabled'], BUTTON: ['aria-busy'], A: ['aria-busy'] }; // attributes that the person changes

export const byId = (id) => document.getElementById(id);

export function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children.flat().filter((child) => child != null && child !== false));
  return made;
}

export function drawing(tag, attributes = {}, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

const same = (a, b) => a.nodeName === b.nodeName && (a.id ?? '') === (b.id ?? '');

function patchAttributes(live, wanted) {
  const own = OWN[live.nodeName] ?? [];
  const kept = live.dataset.source !== undefined && live.dataset.source === wanted.dataset.source ? [...own, 'src'] : own;
  for (const { name, value } of wanted.attributes) {
    if (!kept.includes(name) && live.getAttribute(name) !== value) live.setAttribute(name, value);
  }
  for (const { name } of [...live.attributes]) {
    if (!kept.includes(name) && !wanted.hasAttribute(name)) live.removeAttribute(name);
  }
  for (const name of HANDLERS) if (live[name] !== wanted[name]) live[name] = wanted[name];
}

// Make `live`, a node on the page, look like `wanted`, a new one of the same kind.
function patch(live, wanted) {
  if (live.nodeType !== Node.ELEMENT_NODE) {
    if (live.nodeValue !== wanted.nodeValue) live.nodeValue = wanted.nodeValue;
    return;
  }
  patchAttributes(live, wanted);
  patchChildren(live, [...wanted.childNodes]);
}

export function patchChildren(parent, wanted) {
  const left = [...parent.childNodes];
  let before = parent.firstChild;
  for (const child of wanted) {
    const at = left.findIndex((node) => same(node, child));
    const node = at < 0 ? child : left.splice(at, 1)[0];
    if (at >= 0) patch(node, child);
    if (node === before) before = before.nextSibling;
    else parent.insertBefore(node, before);
  }
  for (const node of left) node.remove();
}

// If the focused element is gone, focus its card, so that the keyboard stays in its place.
export function keepingFocus(draw) {
  const focused = document.activeElement;
  const around = [];
  for (let node = focused; node && node !== document.body; node = node.parentElement) around.push(node);
  draw();
  if (!focused || focused === document.body || document.activeElement === focused) return;
  if (focused.isConnected) focused.focus({ preventScroll: true });
  else around.find((node) => node.isConnected && node.tabIndex >= -1 && node.hasAttribute('tabindex'))?.focus({ preventScroll: true });
}

export const quiet = (...text) => element('p', { className: 'quiet' }, ...text);
export const failure = (text) => text && element('p', { className: 'failed' }, text);

const opened = new Set(); // ids of folds that a person opened, kept while they are not on the page

export function fold(id, summary, content, onopen) {
  const keep = (open) => (open ? opened.add(id) : opened.delete(id));
  const head = element('summary', {}, summary);
  const made = element('details', { id, open: opened.has(id) }, head, content);
  head.onclick = () => keep(!made.open); // a toggle is told later, and the list may be drawn anew before
  made.ontoggle = ({ currentTarget: { open } }) => {
    keep(open);
    onopen?.(open);
  };
  return made;
}

export const card = (id, ...children) => element('li', { id, tabIndex: -1 }, ...children);
export const title = (name, status, word = status, before = null) => element('div', { className: 'title' },
  before, element('h3', {}, name), element('span', { className: `status ${status}` }, word));
export const bar = (label, fraction) => element('progress', { max: 1, value: fraction, ariaLabel: label });

export const when = (created) => new Date(created).toLocaleString([], { dateStyle: 'medium', timeStyle: 'medium' });
export const seconds = (s) => (s < 100 ? `${s.toFixed(1)} s` : s < 6000 ? `${(s / 60).toFixed(1)} min` : `${(s / 3600).toFixed(1)} h`);

export function size(bytes) {
  const units = ['B', 'KiB', 'MiB', 'GiB', 'TiB'];
  const power = bytes > 0 ? Math.min(4, Math.floor(Math.log2(bytes) / 10)) : 0;
  return `${(bytes / 1024 ** power).toFixed(power ? 1 : 0)} ${units[power]}`;
}

const AGES = [[86400, 'day'], [3600, 'hour'], [60, 'minute']];
const AGO = new Intl.RelativeTimeFormat('en');

export function ago(age_s) {
  const [unit_s, unit] = AGES.find(([least_s]) => age_s >= least_s) ?? [];
  return unit ? AGO.format(-Math.floor(age_s / unit_s), unit) : 'just now';
}

// How long ago a time in seconds since 1970 was, to the second where it is less than a minute.
export function since(at_s) {
  const age_s = Math.max(0, Date.now() / 1000 - at_s);
  return age_s < 60 ? `${Math.round(age_s)} s ago` : ago(age_s);
}
