// Buttons that ask the service for something and show the outcome.
import { looksOn, wait } from './api.js';
import { element } from './dom.js';

const SAID_MS = 6000, AGAIN_MS = 500, MOST_TRIES = 30;
const VIEWER = "A viewer's token only looks on; this needs an operator's.";

let refresh = async () => {};
export const onChange = (told) => { refresh = told; };

export function say(text) {
  const place = document.getElementById('said');
  if (place.textContent !== text) place.textContent = text;
  clearTimeout(say.gone);
  say.gone = setTimeout(() => { place.textContent = ''; }, SAID_MS);
}

export function complain(text) {
  const place = document.getElementById('notice');
  if (place.textContent !== text) place.textContent = text;
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
