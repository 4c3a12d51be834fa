// The form of a job filled with what was asked for before, to ask for something else.
import { post } from './api.js';
import { formOf, jobDialog, opener, performed } from './act.js';
import { JOBS } from './words.js';

export function again(item, context, plain = true) {
  const { type, capture, job, ...given } = item.request;
  if (!context.options[type] || !(capture ?? job)) return null;
  const target = capture ? { capture } : { job };
  const submit = (values) => performed(() => post('/jobs', { type, ...target, ...values }), 'The job is queued');
  const heading = `${JOBS[type] ?? type} of ${context.nameOf(capture ?? job)} again`;
  const ask = () => jobDialog(heading, formOf(type, context), context.camerasOf(item), submit, { ...given, name: item.name, priority: item.priority });
  return opener('Do again with other options…', `again-${item.id}`, ask, { plain });
}
