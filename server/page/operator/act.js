// Buttons that ask the service for something and say what came of it.
import { looksOn } from './api.js';
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

// Do it, tell of it, and show what changed.
export async function perform(act, done) {
  try {
    await act();
    complain('');
    if (done) say(done);
  } catch (error) {
    complain(error.message);
  }
  await refresh();
}

// As `perform`, but a fault is the caller's to show: in the dialog that is still open.
export async function performed(act, done) {
  await act();
  complain('');
  if (done) say(done);
  await refresh();
}

// What is refused while a process is still stopping is asked for again, for some seconds.
export async function patiently(act) {
  for (let tries = 1; ; tries += 1) {
    try {
      return await act();
    } catch (error) {
      if (error.status !== 409 || !error.message.includes('still stopping') || tries === MOST_TRIES) throw error;
    }
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
  }
}

// A button that changes something, so one that is off for a viewer's token.
export function button(label, id, act, { plain = true, disabled = false, done = '', danger = false } = {}) {
  const className = danger ? 'plain danger' : plain ? 'plain' : '';
  const made = element('button', { type: 'button', id, disabled: disabled || looksOn(), title: looksOn() ? VIEWER : '', className }, label);
  made.onclick = async (event) => {
    const pressed = event.currentTarget;
    if (pressed.ariaBusy) return; // a second click of the same wish
    pressed.ariaBusy = 'true';
    await perform(act, done);
    pressed.ariaBusy = null;
  };
  return made;
}

export const link = (label, id, href) => element('a', { id, href }, label);
export const actions = (...made) => element('div', { className: 'actions' }, made.flat().filter(Boolean));
