// Buttons and dialogs that ask the service for something and show the outcome.
import { looksOn, post, send, wait } from './api.js';
import { byId, element } from './dom.js';
import { fieldsOf } from './options.js';
import { inWords } from './words.js';

const SAID_MS = 6000, AGAIN_MS = 500, MOST_TRIES = 30;
const VIEWER = "A viewer's token only looks on; this needs an operator's.";

let refresh = async () => {};
export const onChange = (told) => { refresh = told; };

export function say(text) {
  const place = byId('said');
  place.textContent = text;
  clearTimeout(say.gone);
  say.gone = setTimeout(() => { place.textContent = ''; }, SAID_MS);
}

export function complain(text) {
  const place = byId('notice');
  if (place.textContent !== inWords(text)) place.textContent = inWords(text);
  place.hidden = !text;
}

// Act, say `done` and show what changed; the caller shows an error, in the dialog that is still open.
export async function performed(act, done) {
  await act();
  complain('');
  if (done) say(done);
  await refresh();
}

// Repeat a request for some seconds while it is refused because a process is still stopping.
export async function patiently(act) {
  for (let tries = 1; ; tries += 1) {
    try {
      return await act();
    } catch (error) {
      if (error.status !== 409 || !error.message.includes('still stopping') || tries === MOST_TRIES) throw error;
    }
    await wait(AGAIN_MS);
  }
}

// A button that opens a dialog. It is off for a viewer's token, which may change nothing.
export function opener(label, id, onclick, { plain = true, disabled = false, danger = false } = {}) {
  const className = danger ? 'plain danger' : plain ? 'plain' : '';
  return element('button', { type: 'button', id, disabled: disabled || looksOn(), title: looksOn() ? VIEWER : '', className, onclick }, label);
}

// A button that acts at once.
export function button(label, id, act, { done = '', ...options } = {}) {
  const press = async ({ currentTarget: pressed }) => {
    if (pressed.ariaBusy) return; // the second click of a double click
    pressed.ariaBusy = 'true';
    await performed(act, done).catch((error) => { complain(error.message); return refresh(); });
    pressed.ariaBusy = null;
  };
  return opener(label, id, press, options);
}

export const link = (label, id, href) => element('a', { id, href }, label);
export const actions = (...made) => element('div', { className: 'actions' }, made.flat().filter(Boolean));

// A dialog with a form; return the button that goes back.
export function dialog(heading, content, act, label, danger = false) {
  const fault = element('p', { className: 'failed', role: 'alert' });
  const go = element('button', { type: 'submit', id: 'dialog-go', className: danger ? 'danger' : '' }, label);
  const back = element('button', { type: 'button', id: 'dialog-back', className: 'plain' }, 'Back');
  const form = element('form', {}, element('h2', { id: 'dialog-title' }, heading), content, fault,
    actions(go, back));
  const made = element('dialog', { id: 'dialog' }, form);
  made.setAttribute('aria-labelledby', 'dialog-title');
  const from = document.activeElement;
  back.onclick = () => made.close();
  form.onsubmit = async (event) => {
    event.preventDefault();
    go.disabled = true;
    fault.textContent = '';
    try {
      await act();
      made.close();
    } catch (error) {
      fault.textContent = inWords(error.message);
    }
    go.disabled = false;
  };
  made.onclose = () => {
    made.remove();
    (from?.isConnected ? from : byId(from?.id))?.focus();
  };
  document.body.append(made);
  made.showModal();
  return back;
}

// A button that deletes an entry once the person confirms it; the safe answer has the focus.
export function removal(item, path, detail) {
  const act = () => performed(() => send('DELETE', path), `${item.id} is deleted`);
  const ask = () => dialog(`Delete ${item.name ?? item.id}?`, element('p', {}, detail), act, 'Delete', true).focus();
  return opener('Delete', `delete-${item.id}`, ask, { danger: true });
}

// A button for a form that queues a job of a type on `target`, {capture} or {job}; any rig is one of this service.
export function asking(label, heading, type, target, item, context, plain = true) {
  const submit = (values) => performed(() => post('/jobs', { type, ...target, ...values }), `${heading}: queued`);
  return opener(label, `${type}-${item.id}`, () => jobDialog(heading, formOf(type, context), context.camerasOf(item), submit), { plain });
}

// The schema of a form for a type of job: any rig is one of this service.
export function formOf(type, context) {
  const { rig, ...properties } = context.options[type].properties;
  return { ...context.options[type], properties: rig ? { ...properties, rig: { type: 'string', enum: [...context.rigs.keys()] } } : properties };
}

// The fields of a form, filled with what is `given`, as {content, values}.
export function jobFields(schema, cameras, given) {
  const { first, more, values } = fieldsOf(schema, cameras, given);
  const content = element('div', { className: 'fields' }, first,
    more.length > 0 && element('details', {}, element('summary', {}, 'More options'), element('div', { className: 'fields' }, more)));
  return { content, values };
}

// A form for a job of a type, filled with what is `given`; `submit` takes the values that were filled in.
export function jobDialog(heading, schema, cameras, submit, given) {
  const { content, values } = jobFields(schema, cameras, given);
  dialog(heading, content, () => submit(values()), 'Queue');
}
