// One search for both lists: by name, note, id and rig, as the service finds them.
import { byId } from './dom.js';
import { counted } from './words.js';

const PAUSE_MS = 300;
let told = '';

export const sought = () => byId('search').value.trim();
export const asked = () => (sought() ? `&q=${encodeURIComponent(sought())}` : '');

// Call `refresh` once a person stops typing.
export function onSearch(refresh) {
  byId('search-form').onsubmit = (event) => event.preventDefault();
  byId('search').oninput = () => {
    clearTimeout(onSearch.soon);
    onSearch.soon = setTimeout(refresh, PAUSE_MS);
  };
}

// Say how much was found; a screen reader hears it when it changes.
export function tell(found, next) {
  const count = (kind) => `${found[kind].length}${next[kind] ? ' or more' : ''} ${counted(found[kind].length, kind.slice(0, -1)).split(' ')[1]}`;
  const text = sought() ? `Found ${count('captures')} and ${count('jobs')}` : '';
  if (text !== told) byId('found').textContent = text;
  told = text;
}
