// Import of `.dat` files: dropped or chosen, looked into and sent while the person says which camera each is of.
import { get, looksOn, post } from './api.js';
import { complain, opener, performed } from './act.js';
import { bar, byId, element, size } from './dom.js';
import { dropped, grid, guessed, sorted } from './files.js';
import { control, openLarge } from './large.js';
import { common, inWords, keyOf, misfit, optionOf, previewOf } from './layouts.js';
import { setSource } from './media.js';
import { Upload } from './upload.js';

const FIRST_BYTES = 4 << 20; // enough to look into
const labelled = (label, input) => element('label', {}, label, input);

class Row {
  constructor(file, told) {
    this.upload = new Upload(file, told);
    this.found = null;
    this.fault = '';
    this.camera = element('select', { ariaLabel: `Camera of ${file.name}`, onchange: told });
    this.picture = element('img', { alt: `Preview of ${file.name}`, className: 'peek' });
    this.progress = bar(`${file.name} sent`, 0);
    this.line = element('p', { className: 'quiet' });
    this.made = element('li', { className: 'incoming' }, this.picture,
      element('div', {}, element('strong', {}, file.name), labelled('Camera', this.camera), this.progress, this.line));
  }

  async peek(asked = '') {
    await this.upload.begin();
    await this.upload.upTo(FIRST_BYTES);
    if (!this.upload.gone && (!this.found || asked)) this.found = await get(`/uploads/${this.upload.id}/inspection${asked}`);
  }

  draw(layout, rows) {
    const { upload, found } = this;
    this.progress.value = upload.offset / upload.file.size;
    const misfits = this.camera.value && found && layout ? misfit(found, layout) : found?.doubt ?? '';
    const state = this.camera.value === '' ? 'left out' : upload.committed ? 'sent' : `${size(upload.offset)} of ${size(upload.file.size)}`;
    this.line.textContent = this.fault || misfits || state;
    this.line.className = this.fault || misfits ? 'failed' : 'quiet';
    if (layout && found && upload.offset) setSource(this.picture, previewOf(upload.id, layout, rows)).catch((error) => { this.line.textContent = error.message; });
  }
}

class Import {
  constructor({ dats, cameras, others }, context) {
    const told = () => this.draw();
    Object.assign(this, { context, rows: dats.map((file) => new Row(file, told)), given: cameras ? new Upload(cameras, told) : null, rated: [], trying: false, refusal: '' });
    this.rig = element('select', { id: 'import-rig', onchange: () => { this.fill(); this.draw(); } }, [...context.rigs.values()].map((rig) => new Option(rig.name, rig.id)));
    this.rate = element('input', { id: 'import-rate', type: 'number', min: 1, max: 1e7, step: 'any', required: true });
    this.layout = element('select', { id: 'import-layout', onchange: told });
    this.order = element('select', { id: 'import-rows', onchange: told }, [new Option('bottom row first', 'bottom'), new Option('top row first', 'top')]);
    this.poses = element('select', { id: 'import-poses' }, [new Option('as the file says, or else calibrated', ''), new Option('of a drawing: find them from the scene', 'nominal')]);
    this.name = element('input', { id: 'import-name', type: 'text', maxLength: 80, autocomplete: 'off' });
    [this.width, this.height] = ['width', 'height'].map((side) => element('input', { id: `import-${side}`, type: 'number', min: 1, max: 9999, ariaLabel: `Another ${side}`, className: 'short' }));
    this.fault = element('p', { className: 'failed', id: 'import-fault', role: 'alert' });
    this.state = element('p', { className: 'quiet', id: 'import-state', role: 'status' });
    this.left = others.length ? `left out: ${others.map((file) => file.name).join(', ')}` : '';
    this.fill();
  }

  get known() { return this.context.rigs.get(this.rig.value); }
  get ids() { return this.given ? grid(this.rows.length) : this.known.cameras.map((one) => one.id); }
  get chosen() { return this.rated.find(({ layout }) => keyOf(layout) === this.layout.value)?.layout; }
  get used() { return this.rows.filter((row) => row.camera.value); }

  // Offer the cameras of the rig, and guess which file is of which.
  fill() {
    this.rate.value = this.known?.tick_rate_hz ?? 20000;
    const guesses = guessed(this.rows.map((row) => row.upload.file.name), this.ids);
    this.rows.forEach((row, i) => {
      row.camera.replaceChildren(new Option('leave out', ''), ...this.ids.map((id) => new Option(id)));
      row.camera.value = guesses[i];
    });
  }

  open() {
    this.go = Object.assign(control('Import', 'import-go', () => this.accept()), { className: '', disabled: true });
    this.resume = Object.assign(control('Resume', 'import-resume', () => this.run()), { hidden: true });
    const another = element('details', {}, element('summary', {}, 'Another size'), element('div', { className: 'actions' }, this.width, '×', this.height, control('Try', 'import-try', () => this.another())));
    const fields = element('div', { className: 'fields' },
      ...(this.given ? [element('p', { className: 'quiet' }, `Cameras of ${this.given.file.name}`), labelled('Poses', this.poses)] : [labelled('Cameras of the rig', this.rig)]),
      Object.assign(labelled('Layout', this.layout), { className: 'double' }), labelled('Rows', this.order), labelled('Planes a second', this.rate), labelled('Name', this.name), another);
    const body = element('div', { className: 'large-body import' }, fields, this.fault, this.state, element('ul', { className: 'incomings' }, this.rows.map((row) => row.made)));
    this.dialog = openLarge('import', `Import ${this.rows.length} files`, [this.go, this.resume], body, { closing: 'Cancel', closed: () => this.end(),
      back: () => document.activeElement !== byId('large-close') && (byId('large-close').focus(), true) }); // Escape twice
    this.layout.focus();
    this.run();
  }

  // Look into each file, then send the rest; after a fault it goes on where it ended.
  async run() {
    this.resume.hidden = true;
    for (const row of this.rows) row.fault = '';
    await this.each((row) => row.peek());
    this.offer();
    if (this.given) await this.each(async () => { await this.given.begin(); await this.given.finish(); }, this.rows.slice(0, 1));
    await this.each((row) => row.upload.finish(), this.rows.filter((row) => row.upload.id));
    this.resume.hidden = !this.rows.some((row) => row.fault);
    this.draw();
  }

  async each(act, rows = this.rows) {
    for (const row of rows) {
      if (this.over) return;
      await act(row).catch((error) => { row.fault = error.message; });
      this.draw();
    }
  }

  async another() {
    const asked = `?${new URLSearchParams({ width: this.width.value, height: this.height.value })}`;
    this.trying = true; // nothing is imported meanwhile
    await this.each((row) => row.peek(asked));
    this.trying = false;
    this.offer();
    this.draw();
  }

  offer() {
    const before = this.layout.value;
    this.rated = common(this.rows.map((row) => row.found).filter(Boolean));
    this.layout.replaceChildren(...this.rated.map(optionOf));
    if (this.rated.some(({ layout }) => keyOf(layout) === before)) this.layout.value = before;
  }

  // A line for what keeps the files from being imported, or ''.
  get obstacle() {
    const taken = this.used.map((row) => row.camera.value), { chosen } = this;
    const twice = taken.find((id, i) => taken.indexOf(id) !== i), missing = this.given ? [] : this.ids.filter((id) => !taken.includes(id));
    if (twice) return `found two files for ${twice}; choose one camera for each`;
    if (missing.length) return `found no file for ${missing.join(', ')} of ${this.known.name}; drop it too, or choose another rig`;
    const other = !this.given && chosen && this.known.cameras.find((one) => one.width !== chosen.width || one.height !== chosen.height);
    if (other) return `found ${inWords(chosen)}, expected ${other.width} × ${other.height} of ${this.known.name}; choose another layout or rig, or drop its RIG.toml with the files`;
    return this.layout.options.length || !this.rows.every((row) => row.found) ? '' : 'found no layout that fits; give another size';
  }

  draw() {
    for (const row of this.rows) row.draw(this.chosen, this.order.value);
    const sent = this.used.filter((row) => row.upload.committed).length, { obstacle } = this;
    this.fault.textContent = [obstacle, this.refusal, this.left].filter(Boolean).join('; ');
    this.state.textContent = `${sent} of ${this.used.length} files sent`;
    this.go.disabled = Boolean(obstacle) || this.trying || sent < this.used.length || !sent || !this.chosen || Boolean(this.given && !this.given.committed);
  }

  async accept() {
    const { chosen: { format, width, height, bit_order }, used } = this;
    const orders = format === 'm1k40' ? {} : { bit_order, row_order: this.order.value };
    const asked = {
      uploads: Object.fromEntries(used.map((row) => [row.camera.value, row.upload.id])), cameras: this.given ? this.given.id : { rig: this.rig.value },
      tick_rate_hz: Number(this.rate.value), size: [width, height], format, ...orders,
      allow_partial: used.some((row) => row.found.candidates.some((one) => keyOf(one) === keyOf(this.chosen) && one.left_bytes)),
      ...(this.given && this.poses.value && { poses: this.poses.value }),
      ...(this.name.value.trim() && { name: this.name.value.trim() }),
    };
    this.go.disabled = true;
    this.refusal = '';
    try {
      await performed(() => post('/captures:import', asked), 'The import is queued');
      this.accepted = true;
      this.dialog.close();
    } catch (error) {
      this.refusal = error.message;
      this.draw();
    }
  }

  // Remove what is not imported.
  end() {
    this.over = true;
    const kept = this.accepted ? this.used.map((row) => row.upload) : [];
    const all = [...this.rows.map((row) => row.upload), ...(this.given ? [this.given] : [])];
    for (const upload of all) if (!kept.includes(upload)) upload.remove();
  }
}

function start(files, context) {
  const found = sorted(files), empty = found.dats.find((file) => !file.size);
  if (!files.length) return;
  if (!found.dats.length) complain(`found ${files.map((file) => file.name).join(', ')}, expected .dat files; drop those of a recording`);
  else if (empty) complain(`found no bytes in ${empty.name}, expected planes; drop the file that was recorded`);
  else new Import(found, context).open();
}

// Let a person drop files onto a part of the page, or choose them.
export function offerImport(place, onto, context) {
  const input = element('input', { type: 'file', id: 'import-input', multiple: true, hidden: true, accept: '.dat,.toml,.json', ariaLabel: 'Files to import' });
  input.onchange = () => {
    start([...input.files], context);
    input.value = '';
  };
  place.replaceChildren(opener('Import…', 'import-open', () => input.click()), input);
  const holds = (event) => event.dataTransfer?.types.includes('Files');
  window.addEventListener('dragover', (event) => { if (holds(event)) event.preventDefault(); }); // else the browser leaves the page for the file
  window.addEventListener('drop', (event) => { if (holds(event)) event.preventDefault(); });
  const over = (event) => onto.classList.toggle('dropping', event.type === 'dragover' && holds(event) && !looksOn());
  onto.ondragover = over;
  onto.ondragleave = over;
  onto.ondrop = async (event) => {
    over(event);
    if (!holds(event) || looksOn()) return;
    event.preventDefault();
    await dropped(event.dataTransfer).then((files) => start(files, context), (error) => complain(`found files that cannot be read: ${error.message}`));
  };
}
