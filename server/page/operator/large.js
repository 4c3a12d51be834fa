// A dialog that fills the window: a heading, controls and a body. Escape goes back one step, then closes it.
import { byId, element } from './dom.js';

let shown = null;
export const isLarge = (key) => shown?.key === key;
export const refreshLarge = () => shown?.refresh?.();

export const control = (label, id, onclick, title = '') => element('button', { type: 'button', id, className: 'plain', title, onclick }, label);

// `keys` takes a key's name and says whether it was used; `back` says whether it went back one step; `refresh` is called
// when the state of the page has changed, `closed` at the end. Returns the dialog.
export function openLarge(key, heading, controls, body, { keys = () => false, back = () => false, refresh, closing = 'Close', closed } = {}) {
  const from = document.activeElement;
  const close = control(closing, 'large-close', () => made.close(), 'Escape');
  const head = element('header', { className: 'large-head' }, element('h2', { id: 'large-title' }, heading),
    element('div', { className: 'actions' }, controls, close));
  const made = element('dialog', { id: 'large', className: 'large' }, element('div', { className: 'large-all' }, head, body));
  made.setAttribute('aria-labelledby', 'large-title');
  made.onkeydown = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const used = event.key === 'Escape' ? back() || made.close() || true : keys(event.key, event);
    if (used) event.preventDefault();
  };
  made.oncancel = (event) => { if (event.target === made && back()) event.preventDefault(); }; // a telephone's back gesture
  made.onclose = () => {
    shown = null;
    made.remove();
    closed?.();
    (from?.isConnected ? from : byId(from?.id))?.focus();
  };
  shown = { key, refresh };
  document.body.append(made);
  made.showModal();
  return made;
}
