// The name and note of a capture or job: shown on its card, and changed in a form.
import { send } from './api.js';
import { dialog, opener, performed } from './act.js';
import { byId, element } from './dom.js';

const MOST_NAME = 80, MOST_NOTE = 2000;

export const note = (item) => item.note && element('p', { className: 'note' }, item.note);

export function labelling(item, path) {
  const ask = () => {
    const name = element('input', { id: 'label-name', type: 'text', maxLength: MOST_NAME, autocomplete: 'off', value: item.name ?? '' });
    const text = element('textarea', { id: 'label-note', maxLength: MOST_NOTE, rows: 5, value: item.note ?? '' });
    const content = element('div', { className: 'fields' },
      element('label', { htmlFor: name.id, className: 'wide' }, 'Name', name),
      element('label', { htmlFor: text.id, className: 'wide' }, 'Note', text));
    const given = (id) => byId(id).value.trim() || null;
    const save = () => performed(() => send('PATCH', path, { name: given(name.id), note: given(text.id) }), 'Name and note are kept');
    dialog(`Name and note of ${item.name ?? item.id}`, content, save, 'Keep');
    text.focus();
  };
  return opener('Name and note…', `label-${item.id}`, ask);
}
