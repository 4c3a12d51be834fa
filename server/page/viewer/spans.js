// The spans of a long recording: fetches the one that is shown and, while time runs, the next; keeps their neighbours.
import { wait } from '../operator/api.js';
import { byId } from '../operator/dom.js';
import { loadSpan } from './scene.js';

const APART_MS = 150; // between requests that a moving slider gives up

export class Spans {
  /** `changed` is called when another frame is due, `failed` with a line when what is to be shown cannot be had. */
  constructor(scene, splats, changed, failed) {
    Object.assign(this, { scene, splats, changed, failed, spans: scene.manifest.spans, kept: new Map(), number: 0 });
    this.shown = null; // the span that is on the graphics device
    this.loading = null; // {number, stop} of the one request under way
    this.fault = null; // {number, seen}: what could not be had, and whether a person was told
  }

  /** Show what there is at an instant; return whether that is here. `runs`: whether the next span is wanted soon. */
  moveTo(instant_s, runs) {
    this.number = Math.max(this.spans.findLastIndex((span) => span.first_s <= instant_s), 0);
    this.#fetch((this.number + 1) % this.spans.length, runs);
    const span = this.kept.get(this.number);
    this.#tell(span ? '' : byId('awaited').textContent || 'Loading');
    if (!span) return false;
    if (span !== this.shown) this.splats.show(span);
    this.shown = span;
    const [first, last] = span.manifest.clip_s;
    this.splats.moveTo((instant_s - first) / Math.max(last - first, Number.MIN_VALUE));
    return true;
  }

  /** Try again what could not be had; return whether a person was told that. */
  again() {
    const told = this.fault?.seen ?? false;
    this.fault = null;
    return told;
  }

  #fetch(next, runs) {
    const { number, kept, loading, fault } = this;
    for (const k of kept.keys()) if (![number - 1, number, next].includes(k)) kept.delete(k);
    byId('picture').dataset.kept = [...kept.keys()];
    if (loading && ![number, next].includes(loading.number)) loading.stop.abort();
    const due = (runs ? [number, next] : [number]).find((k) => !kept.has(k));
    if (loading || due === undefined || (due === fault?.number && (fault.seen || due !== number))) return;
    this.#load(due);
  }

  async #load(number) {
    const stop = new AbortController();
    this.loading = { number, stop };
    const progress = (got, all) => { if (number === this.number) this.#tell(`Loading ${(got / 1e6).toFixed(1)} of ${(all / 1e6).toFixed(1)} MB`); };
    try {
      this.kept.set(number, await loadSpan(this.scene, number, { signal: stop.signal, progress }));
      this.fault = null;
    } catch (error) {
      if (error.name === 'AbortError') await wait(APART_MS);
      else this.#fail(number, error);
    }
    this.loading = null;
    this.changed();
  }

  #fail(number, error) {
    const seen = number === this.number;
    this.fault = { number, seen };
    if (!seen) return; // what comes next is tried once more when it has come
    const ms = (instant_s) => (1000 * (instant_s - this.scene.manifest.clip_s[0])).toFixed(2);
    const { first_s: first, last_s: last } = this.spans[number];
    const advice = error.message.endsWith('reload') ? '.' : '. Play on to try again.';
    this.failed(`${ms(first)} to ${ms(last)} ms cannot be shown. ${error.message}`.replace(/\.$/, '') + advice);
  }

  #tell(text) { byId('awaited').textContent = this.fault?.seen ? '' : text; }
}
