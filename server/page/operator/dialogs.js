// Dialogs: a question with two answers, and a form for a job.
import { performed, opener } from './act.js';
import { send } from './api.js';
import { element } from './dom.js';
import { fieldsOf } from './options.js';

function dialog(heading, content, act, label, danger = false) {
  const fault = element('p', { className: 'failed', role: 'alert' });
  const go = element('button', { type: 'submit', id: 'dialog-go', className: danger ? 'danger' : '' }, label);
  const back = element('button', { type: 'button', id: 'dialog-back', className: 'plain' }, 'Back');
  const form = element('form', {}, element('h2', { id: 'dialog-title' }, heading), content, fault,
    element('div', { className: 'actions' }, go, back));
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
      fault.textContent = error.message;
    }
    go.disabled = false;
  };
  made.onclose = () => {
    made.remove();
    (from?.isConnected ? from : document.getElementById(from?.id))?.focus();
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

// A form for a job of a type; `submit` takes the values that were filled in.
export function jobDialog(heading, schema, cameras, submit) {
  const { first, more, values } = fieldsOf(schema, cameras, 'option');
  const content = element('div', { className: 'fields' }, first,
    more.length > 0 && element('details', {}, element('summary', {}, 'More options'), element('div', { className: 'fields' }, more)));
  dialog(heading, content, () => submit(values()), 'Queue');
}
