// The captures or jobs that a person has chosen, and what can be done with all of them at once.
import { looksOn } from './api.js';
import { actions } from './act.js';
import { byId, element } from './dom.js';
import { counted } from './words.js';

const chosen = { captures: new Set(), jobs: new Set() };
let redraw = () => {};
export const onChosen = (draw) => { redraw = draw; };

export const chosenOf = (kind, items) => items.filter((item) => chosen[kind].has(item.id));

export function unchoose(kind, ids) {
  for (const id of ids) chosen[kind].delete(id);
}

// The box of a card. A viewer's token, which may change nothing, has none.
export function box(kind, item) {
  if (looksOn()) return null;
  const made = element('input', { type: 'checkbox', id: `choose-${item.id}`, className: 'choose', checked: chosen[kind].has(item.id), ariaLabel: `Choose ${item.name ?? item.id}` });
  made.onchange = ({ currentTarget: { checked } }) => {
    if (checked) chosen[kind].add(item.id);
    else chosen[kind].delete(item.id);
    redraw();
  };
  return made;
}

// The line above a list: choose all that is shown, how many are chosen, and `offers` for these.
// What is not shown is not chosen: nobody deletes what they cannot see.
export function bar(kind, items, offers) {
  const shown = new Set(items.map((item) => item.id));
  for (const id of chosen[kind]) if (!shown.has(id)) chosen[kind].delete(id);
  if (looksOn() || !items.length) return [];
  const all = element('input', { type: 'checkbox', id: `choose-all-${kind}` });
  all.onchange = ({ currentTarget: { checked } }) => {
    chosen[kind] = checked ? new Set(shown) : new Set();
    settle(kind, items); // at once: a click before the next drawing is on what is seen
    redraw();
  };
  const number = chosen[kind].size;
  return [
    element('label', { className: 'check', htmlFor: all.id, id: `choose-label-${kind}` }, all, 'Choose all shown'),
    element('span', { id: `chosen-${kind}`, role: 'status', className: 'quiet' }, number ? `${counted(number, kind.slice(0, -1))} chosen` : ''),
    number > 0 && actions(offers(chosenOf(kind, items))),
  ].filter(Boolean);
}

// Boxes keep what a person clicked; bring all of them to what is chosen.
export function settle(kind, items) {
  for (const { id } of items) {
    const live = byId(`choose-${id}`);
    if (live) live.checked = chosen[kind].has(id);
  }
  const all = byId(`choose-all-${kind}`);
  if (!all) return;
  all.checked = items.length > 0 && chosen[kind].size === items.length;
  all.indeterminate = chosen[kind].size > 0 && !all.checked;
}
