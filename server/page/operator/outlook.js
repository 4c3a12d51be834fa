// The place of a job in its queue, and when it is expected to begin and to end; silent where the service does not know.
import { quiet } from './dom.js';
import { ended } from './results.js';
import { ordinal } from './words.js';

const DAY_MS = 86_400_000, SOON_MS = 60_000;

function moment(text) {
  const at = new Date(text), off = at - Date.now();
  if (off < SOON_MS) return 'within a minute';
  return `about ${at.toLocaleString([], { ...(off > DAY_MS / 2 && { weekday: 'short' }), ...(off > 6 * DAY_MS && { dateStyle: undefined, day: 'numeric', month: 'short' }), hour: '2-digit', minute: '2-digit' })}`;
}

const queue = (item) => (item.type === 'reconstruct' ? 'reconstructions' : 'other jobs');

export function outlook(item) {
  if (ended(item)) return null;
  const waits = item.status === 'queued';
  const parts = [
    waits && (item.position ? `${ordinal(item.position)} in the queue of ${queue(item)}` : null),
    waits && item.expected_begin && `begins ${moment(item.expected_begin)}`,
    item.expected_end && `ends ${moment(item.expected_end)}`,
  ].filter(Boolean);
  return parts.length ? quiet(parts.join(' · ')) : null;
}
