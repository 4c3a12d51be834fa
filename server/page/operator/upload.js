// Sends a file piece by piece; a connection that breaks loses the piece under way, and the rest follows where it ended.
import { get, post, request, send, wait } from './api.js';

const PIECE_BYTES = 8 << 20, AGAIN_MS = 1000, MOST_TRIES = 5;
const PASSING = [0, 408, 409, 429, 502, 503, 504]; // refusals that another try may overcome

export class Upload {
  constructor(file, told) {
    Object.assign(this, { file, told, id: null, offset: 0, committed: false, gone: false, stop: new AbortController() });
  }

  async begin() {
    const { name, size } = this.file;
    this.id ??= (await post('/uploads', { name: name.slice(-80), bytes: size })).id;
    if (this.gone) await this.remove();
  }

  // Send what is missing of the first `end` bytes.
  async upTo(end) {
    const last = Math.min(end, this.file.size);
    for (let tries = 0; this.offset < last && !this.gone;) {
      try {
        await this.piece(Math.min(last, this.offset + PIECE_BYTES));
        tries = 0;
      } catch (error) {
        tries += 1;
        if (this.gone) return;
        if (!PASSING.includes(error.status) || tries === MOST_TRIES) throw error;
        await wait(AGAIN_MS);
        this.offset = await get(`/uploads/${this.id}`).then((found) => found.offset, () => this.offset);
      }
      this.told();
    }
  }

  async piece(end) {
    const answer = await request(`/v1/uploads/${this.id}`, { method: 'PATCH', body: this.file.slice(this.offset, end), signal: this.stop.signal,
      headers: { 'Upload-Offset': String(this.offset), 'Content-Type': 'application/octet-stream' } });
    this.offset = (await answer.json()).offset;
  }

  async finish() {
    await this.upTo(this.file.size);
    if (this.gone || this.committed) return;
    await post(`/uploads/${this.id}/commit`);
    this.committed = true;
    this.told();
  }

  // Stop sending, and delete what was sent; while the last piece is being written the service refuses that.
  async remove() {
    this.gone = true;
    this.stop.abort();
    for (let tries = 0; this.id && tries < MOST_TRIES; tries += 1) {
      try {
        return await send('DELETE', `/uploads/${this.id}`);
      } catch (error) {
        if (!PASSING.includes(error.status)) return null;
      }
      await wait(AGAIN_MS);
    }
    return null;
  }
}
