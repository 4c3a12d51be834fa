// What a job is called where it has no name of its own.
import { get } from './api.js';
import { JOBS } from './words.js';

/** Return the heading of a job; `nameOf` gives the name of a capture or job by its id. */
export function heading(item, nameOf) {
  const word = JOBS[item.type] ?? item.type;
  const { job, capture } = item.request;
  return item.name ?? (job || capture ? `${word} of ${nameOf(job ?? capture)}` : word);
}

/** Ask for the heading of one job, the id where nothing is known of it. */
export async function headingOf(id) {
  const item = await get(`/jobs/${encodeURIComponent(id)}`).catch(() => null);
  if (!item || item.name) return item?.name ?? id;
  const { job, capture } = item.request;
  const target = job || capture ? await get(job ? `/jobs/${job}` : `/captures/${capture}`).catch(() => null) : null;
  return heading(item, (of) => target?.name ?? of);
}
