// The light of a picture: how many of its pixels are how bright, as bars from dark to saturated.
import { drawing } from './dom.js';

const WIDE = 320, TALL = 64;

export const percent = (share) => `${(100 * share).toFixed(share > 0 && share < 0.001 ? 2 : 1)} %`;

export function histogram(shares, label) {
  const most = Math.max(...shares, 1e-9), step = WIDE / shares.length;
  const bars = shares.map((share, i) => {
    const height = share > 0 ? Math.max(1, TALL * Math.sqrt(share / most)) : 0; // few pixels can be seen beside many
    return drawing('rect', { x: i * step, y: TALL - height, width: step - 1, height });
  });
  return drawing('svg', { class: 'histogram', viewBox: `0 0 ${WIDE} ${TALL}`, preserveAspectRatio: 'none', role: 'img', 'aria-label': label }, ...bars);
}
