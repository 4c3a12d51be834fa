// Error against time: during training from the messages of the stage, afterwards from the held-out camera's scores.
import { drawing, element } from './dom.js';

const W = 308, H = 150, RIGHT = 24, TOP = 8, BOTTOM = 24; // no wider than on a telephone, so that text is not made smaller
const DIGIT = 7.5, BESIDE = 10; // widths of a digit at most, and of the room around a label
const UNITS = [[7200, 3600, 'h'], [300, 60, 'min'], [0, 1, 's']]; // from so many seconds on
const METRICS = { psnr_db: ['PSNR', 'dB'], loss: ['loss', ''], 'counts.rmse': ['count error', 'spikes'] };

// Return {metric, value} of a training's message, such as "step 10, loss 0.0312, PSNR 21.30 dB", or null.
function figureIn(message) {
  const found = /PSNR (-?\d+(?:\.\d+)?) dB/.exec(message);
  if (found) return { metric: 'psnr_db', value: Number(found[1]) };
  const loss = /loss (\d+(?:\.\d+)?(?:e-?\d+)?)/.exec(message);
  return loss ? { metric: 'loss', value: Number(loss[1]) } : null;
}

export function addFigure(points, progress, seq) {
  const figure = progress.stage === 'train' ? figureIn(progress.message) : null;
  if (!figure || points.some((point) => point.seq === seq)) return points;
  const at = Object.values(progress.seconds).reduce((sum, s) => sum + s, 0);
  return [...points, { seq, seconds: at, ...figure }].sort((a, b) => a.seq - b.seq);
}

// Return the points of error_vs_time.json, which the report writes.
export function scored({ rows = [] }) {
  const metric = ['psnr_db', 'counts.rmse'].find((name) => rows.some((row) => Number.isFinite(row[name])));
  if (!metric) return [];
  return rows.filter((row) => Number.isFinite(row[metric])).map((row) => ({ seconds: row.seconds, value: row[metric], metric }));
}

function ticks(low, high, count) {
  const rough = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
  const found = [];
  for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-6; t += step) found.push(Number(t.toPrecision(6)));
  return found;
}

function range(values, pad) {
  const low = Math.min(...values), high = Math.max(...values);
  const room = (high - low) * pad || Math.abs(high) * 0.1 || 1;
  return [low - room, high + room];
}

function grid({ x, y, left, per, word }, xs, ys, unit) {
  return [
    ...ys.flatMap((value) => [
      drawing('line', { x1: left, x2: W - RIGHT, y1: y(value), y2: y(value), class: 'grid' }),
      drawing('text', { x: left - 6, y: y(value) + 4, 'text-anchor': 'end' }, String(value)),
    ]),
    ...xs.map((value) => drawing('text', { x: x(value * per), y: H - 6, 'text-anchor': 'middle' }, `${value} ${word}`)),
    drawing('text', { x: left + 4, y: TOP + 10, class: 'unit' }, unit),
  ];
}

// `of` says which images the figures are about: one word has one meaning on a card.
export function curve(points, caption, of) {
  if (points.length < 2) return null;
  const [name, unit] = METRICS[points[0].metric];
  const shown = points.filter((point) => point.metric === points[0].metric);
  const last = shown.at(-1);
  const first = shown[0].seconds > 0.3 * last.seconds ? shown[0].seconds : 0; // a page opened late shows only what it saw
  const end = Math.max(last.seconds, first + 0.1);
  const [low, high] = range(shown.map((point) => point.value), 0.08);
  const ys = ticks(low, high, 4);
  const left = DIGIT * Math.max(...ys.map((value) => String(value).length)) + BESIDE;
  const [, per, word] = UNITS.find(([least_s]) => end >= least_s);
  const x = (s) => left + ((W - left - RIGHT) * (s - first)) / (end - first);
  const y = (value) => TOP + ((H - TOP - BOTTOM) * (high - value)) / (high - low);
  const line = shown.map((point, i) => `${i ? 'L' : 'M'}${x(point.seconds).toFixed(1)} ${y(point.value).toFixed(1)}`).join('');
  const summary = `${of} ${name} ${Number(last.value.toPrecision(4))} ${unit}`.trim() + ` after ${last.seconds.toFixed(1)} s`;
  return element('figure', { className: 'curve' },
    drawing('svg', { viewBox: `0 0 ${W} ${H}`, role: 'img', 'aria-label': `${caption}: ${summary}` },
      ...grid({ x, y, left, per, word }, ticks(first / per, end / per, 4), ys, unit),
      drawing('path', { d: line, class: 'line' }),
      drawing('circle', { cx: x(last.seconds), cy: y(last.value), r: 3.5, class: 'dot' })),
    element('figcaption', { className: 'quiet' }, `${caption}: `, element('strong', {}, summary)));
}
