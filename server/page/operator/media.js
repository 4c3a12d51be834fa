// Pictures, videos and downloads, with or without a token.
import { address, token } from './api.js';
import { element } from './dom.js';

function sourced(made, path) {
  made.dataset.source = path;
  if (token()) address(path).then((url) => { if (made.isConnected || !made.src) made.src = url; }, () => { made.hidden = true; });
  else made.src = path;
  return made;
}

export const picture = (path, alt, className = '') => sourced(
  element('img', { alt, className, loading: token() ? 'eager' : 'lazy', decoding: 'async' }), path);
export const video = (path, label) => sourced(
  element('video', { controls: true, loop: true, muted: true, playsInline: true, preload: 'metadata', ariaLabel: label }), path);

// A link that saves a file; with a token the file is fetched first, because links send no header.
export function download(id, path, name, label) {
  const made = element('a', { id, href: path, download: name }, label);
  if (!token()) return made;
  made.onclick = async (event) => {
    event.preventDefault();
    const link = event.currentTarget;
    link.ariaBusy = 'true';
    try {
      element('a', { href: await address(path), download: name }).click();
    } finally {
      link.ariaBusy = null;
    }
  };
  return made;
}

export const artefact = (job, name) => `/v1/jobs/${job}/artefacts/${name.split('/').map(encodeURIComponent).join('/')}`;
