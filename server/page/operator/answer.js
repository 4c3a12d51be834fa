// What a job found out, in labelled lines: names become words, and units stand behind the numbers.
import { element } from './dom.js';

const MOST_LINES = 200;
const UNITS = { s: 's', ms: 'ms', us: 'µs', px: 'px', deg: '°', db: 'dB', m: 'm', mm: 'mm', hz: 'Hz', percent: '%', ppm: 'ppm', mb: 'MB', bytes: 'bytes' };
const WORDS = {
  psnr_db: 'held-out PSNR', dynamic_psnr_db: 'held-out PSNR of movers', ssim: 'held-out SSIM', dynamic_ssim: 'held-out SSIM of movers',
  abs_rel: 'depth error AbsRel', 'counts.rmse': 'count error', delta_1_25: 'depth within 25 %', sd: 'standard deviation', fits: 'calibration fits',
  sound: 'every byte as it was written', nearest_view: 'nearest camera instead', depth_blend: 'blend of cameras instead', held_out: 'held-out camera',
};

// Return [label, unit] of a name such as rotation_deg_sd or nearest_view.psnr_db.
function named(name) {
  if (WORDS[name]) return [WORDS[name], UNITS[name.split('_').at(-1)] ?? ''];
  const at = name.lastIndexOf('.');
  if (at > 0) {
    const [head] = named(name.slice(0, at)), [tail, unit] = named(name.slice(at + 1));
    return [`${head}: ${tail}`, unit];
  }
  const parts = name.replace(/_sd$/, '').split('_');
  const unit = parts.length > 1 ? UNITS[parts.at(-1)] : undefined;
  const words = (unit ? parts.slice(0, -1) : parts).map((part) => WORDS[part] ?? part).join(' ');
  return [name.endsWith('_sd') ? `${words}, standard deviation` : words, unit ?? ''];
}

const scalar = (value) => value === null || typeof value !== 'object';
const isPath = (value) => typeof value === 'string' && value.startsWith('/');

function said(value) {
  if (typeof value === 'boolean') return value ? 'yes' : 'no';
  if (typeof value === 'number') return String(Number(value.toPrecision(5)));
  return String(value);
}

// Yield [label, text] for everything in a document; what is in a list is told by its id or number.
function* linesOf(value, name = '') {
  if (value === null || value === undefined || isPath(value)) return;
  const [label, unit] = named(name);
  if (scalar(value)) {
    yield [label, `${said(value)}${unit && typeof value === 'number' ? ` ${unit}` : ''}`];
  } else if (Array.isArray(value) && value.every(scalar)) {
    yield [label, value.length ? value.map(said).join(', ') : 'none'];
  } else {
    for (const [key, inner] of Object.entries(value)) {
      const of = Array.isArray(value) ? inner.id ?? inner.camera ?? inner.name ?? String(Number(key) + 1) : key;
      for (const [word, text] of linesOf(inner, of)) yield [scalar(inner) && name ? `${label}: ${word}` : word, text];
    }
  }
}

export function answer(found) {
  const lines = [...linesOf(found)];
  const rows = lines.slice(0, MOST_LINES).flatMap(([label, text]) => [element('dt', {}, label), element('dd', {}, text)]);
  if (lines.length > MOST_LINES) rows.push(element('dt', {}, 'more'), element('dd', {}, `${lines.length - MOST_LINES} lines in result.json`));
  return element('dl', { className: 'answer', tabIndex: 0, ariaLabel: 'Result' }, rows);
}
