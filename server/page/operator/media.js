// Pictures, videos and downloads, with or without a token.
import { address, token } from './api.js';
import { byId, element } from './dom.js';

// Name the source of a picture or video. With a token it comes later, and goes to the element that shows it by then.
function sourced(made, path) {
  made.dataset.source = path;
  if (token()) address(path).then((url) => { for (const one of [made, ...document.querySelectorAll(`[data-source="${CSS.escape(path)}"]`)]) one.src ||= url; }, () => { made.hidden = true; });
  else made.src = path;
  return made;
}

// Give a picture on the page another source; the old one is seen until the new one is there.
export async function setSource(image, path) {
  if (image.dataset.path === path) return;
  image.dataset.path = path;
  const url = token() ? await address(path) : path;
  if (image.dataset.path === path) image.src = url;
}

// A picture that is renewed under one name: each `version` takes the place of the one before when it is there.
export function renewed(id, path, version, alt) {
  const made = element('img', { id, alt, loading: token() ? 'eager' : 'lazy', decoding: 'async' });
  const seen = byId(id) ?? made; // merging leaves the sources of the one on the page as they are
  setSource(seen, `${path}?of=${version}`).catch(() => {});
  Object.assign(made.dataset, { source: path, path: seen.dataset.path });
  seen.dataset.source = path;
  return made;
}

// A picture that opens large; in another tab, as a link does.
export function enlarging(path, alt, className, open, shown = picture(path, alt, className)) {
  const onclick = (event) => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    open();
  };
  return element('a', { href: path, className: 'open-large', title: 'Open large', onclick }, shown);
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
