// The layouts that files of spikes may have, as the service has found them.
const FORMATS = { vidar: '', vidar416: ', 16 bits behind each row', m1k40: ', M1K40' };
export const keyOf = (one) => [one.format, one.width, one.height, one.bit_order].join();
export const inWords = (one) => `${one.width} × ${one.height}${FORMATS[one.format]}${one.format === 'm1k40' ? '' : `, ${one.bit_order} first`}`;

// All layouts found in any file, those first that fit all files best.
export function common(inspections) {
  const found = new Map();
  for (const { candidates } of inspections) {
    for (const one of candidates) {
      const known = found.get(keyOf(one)) ?? { layout: one, sum: 0 };
      found.set(keyOf(one), { ...known, sum: known.sum + one.plausibility });
    }
  }
  const rated = [...found.values()].map(({ layout, sum }) => ({ layout, fit: sum / inspections.length }));
  return rated.sort((a, b) => b.fit - a.fit);
}

export const optionOf = ({ layout, fit }) => new Option(`${inWords(layout)} (${Math.round(100 * fit)} % plausible)`, keyOf(layout));

// A line for a file that does not fit the layout chosen for all, or ''.
export function misfit({ candidates, doubt }, chosen) {
  const [best] = candidates, mine = candidates.find((one) => keyOf(one) === keyOf(chosen));
  if (!best || doubt) return doubt ?? '';
  if (keyOf(best) !== keyOf(chosen)) return `found ${inWords(best)} likelier than ${inWords(chosen)}; choose it for all, or leave this file out`;
  return mine.left_bytes ? `found ${mine.left_bytes} bytes behind ${mine.planes} whole planes` : '';
}

export function previewOf(id, layout, rows) {
  const size = layout.format === 'm1k40' ? {} : { width: layout.width, height: layout.height, bit_order: layout.bit_order, row_order: rows };
  return `/v1/uploads/${id}/preview?${new URLSearchParams({ format: layout.format, ...size })}`;
}
