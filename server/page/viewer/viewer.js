// The viewer's page, /viewer.html?job=ID: loads the scene of a job and plays it.
import { byId } from '../operator/dom.js';
import { headingOf } from '../operator/naming.js';
import { SceneError, loadScene } from './scene.js';

const SAID_MS = 8000;
const PASS_S = 4; // seconds that a clip, or a span of a long one, lasts on the screen at speed 1
const FASTER = [64, 16, 4]; // speeds of recordings of as many spans

function say(text, failed = false) {
  Object.assign(byId('message'), { textContent: text, hidden: !text, className: failed ? 'failed' : '', role: failed ? 'alert' : 'status' });
}

/** The time shown: u in [0, 1] of the clip, whether it runs, and whether it waits for what is to be shown. */
class Clock {
  constructor([first, last], pass_s, changed) {
    this.pass_s = pass_s;
    this.waits = false;
    this.lasts_ms = (last - first) * 1000;
    this.changed = changed;
    this.clip = [first, last];
    this.u = 0;
    this.speed = 1;
    this.running = false;
    this.tell();
  }

  get instant_s() { return Math.min(this.clip[0] + this.u * (this.clip[1] - this.clip[0]), this.clip[1]); }

  set instant_s(value) { this.seek((value - this.clip[0]) / Math.max(this.clip[1] - this.clip[0], Number.MIN_VALUE)); }

  get factor() { return this.pass_s * 1000 / this.speed / this.lasts_ms; }

  tell() {
    const text = `${(this.u * this.lasts_ms).toFixed(2)} of ${this.lasts_ms.toFixed(2)} ms`;
    Object.assign(byId('time'), { value: this.u, ariaValueText: text });
    byId('instant').textContent = text;
    byId('slowness').textContent = this.factor >= 1 ? `slowed ${Math.round(this.factor)} times` : '';
    Object.assign(byId('play'), { textContent: this.running ? 'Pause' : 'Play', ariaPressed: this.running });
  }

  seek(u) {
    this.u = u;
    this.tell();
    this.changed();
  }

  toggle() {
    this.running = !this.running;
    this.before = performance.now();
    this.seek(this.u);
  }

  stop() {
    this.running = false;
    this.tell();
  }

  /** Advance to `now`; return whether the time changed. */
  tick(now) {
    const [before, passes] = [this.before, this.running && !this.waits];
    this.before = now;
    if (!passes) return false;
    this.u = (this.u + Math.max(now - before, 0) / 1000 / this.pass_s * this.speed) % 1;
    this.tell();
    return true;
  }
}

class Player {
  constructor(job, scene, parts) {
    const canvas = byId('picture');
    const { cameras } = scene.manifest;
    this.view = new parts.View(cameras, scene.manifest.centre);
    this.view.enter(cameras.find((camera) => camera.held_out) ?? cameras[0]);
    const spans = scene.manifest.spans?.length ?? 1;
    this.compare = new parts.Compare(job, scene.manifest.clip_s, spans, () => this.request());
    this.cameras = new parts.Cameras(scene.manifest, byId('names'), byId('edge'));
    this.splats = parts.makeSplats(scene);
    this.picture = new parts.Picture(canvas, this.splats.mesh, this.cameras.scene, scene.manifest, () => this.request());
    this.spans = scene.manifest.spans && new parts.Spans(scene, this.splats, () => this.request(), (line) => this.fail(line));
    this.clock = new Clock(scene.manifest.clip_s, PASS_S * spans, () => this.seek());
    this.moved = true;
    this.depths = scene.manifest.depth_m;
    this.trust = (centre) => parts.errorInWords(scene.manifest.expected_error, centre);
    this.due = false;
    this.frames = 0;
    new ResizeObserver(() => { this.size = this.picture.resize(); this.request(); }).observe(byId('stage'));
    this.size = this.picture.resize();
    parts.steer(canvas, this.view, () => this.size, () => this.request());
    canvas.addEventListener('webglcontextlost', () => say('found the graphics device gone; reload the page', true));
  }

  seek() {
    this.moved = true;
    if (this.spans?.again()) tell('');
    this.request();
  }

  fail(line) {
    this.clock.stop();
    tell(line, true);
  }

  /** Show the instant of the clock, or let it wait until that is here. */
  arrive() {
    const { clock, spans, splats } = this;
    if (spans) clock.waits = !spans.moveTo(clock.instant_s, clock.running);
    else splats.moveTo(clock.u);
    byId('save').disabled = clock.waits; // its name would have another instant than its picture
    this.moved = false;
  }

  request() {
    byId('picture').dataset.settled = 'no';
    if (this.due) return;
    this.due = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.due = false;
    if (this.clock.tick(now) || this.moved || this.clock.waits) this.arrive();
    this.cameras.place(this.view, this.size);
    const [near, far] = this.view.depths(this.depths);
    byId('near').textContent = `${near.toPrecision(3)} m`;
    byId('far').textContent = `${far.toPrecision(3)} m`;
    this.picture.depths = [near, far];
    this.picture.draw(this.view, this.size);
    this.compare.place(this.view, this.size, this.clock.u, this.clock.running);
    byId('from').value = this.view.camera?.id ?? '';
    byId('trust').textContent = this.trust(this.view.centre);
    this.frames += 1;
    byId('picture').dataset.frames = this.frames;
    if (this.clock.waits) return;
    if (this.clock.running) this.request();
    else if (this.picture.settled && !this.due) byId('picture').dataset.settled = 'yes';
  }
}

function fillForm(manifest, nameOf) {
  byId('from').append(...manifest.cameras.map((camera) => new Option(nameOf(camera), camera.id)));
  const { spans } = manifest;
  const moves = spans ? spans.some((span) => span.length > 0) : manifest.moving > 0 && manifest.motion !== 'static';
  for (const id of ['play', 'time', 'speed']) byId(id).disabled = !moves;
  if (spans) offerSpeeds(spans.length);
  const what = moves ? `${manifest.moving.toLocaleString('en')} of them moving${spans ? `, in ${spans.length} spans` : ''}` : 'nothing moves';
  byId('what').textContent = `${manifest.count.toLocaleString('en')} Gaussians, ${what} · model ${manifest.model}`;
}

/** Let a recording of many spans be passed through faster, and its slider be moved as finely as that of one. */
function offerSpeeds(spans) {
  byId('time').step /= spans;
  byId('speed').prepend(...FASTER.filter((speed) => speed <= spans).map((speed) => new Option('', speed)));
  for (const option of byId('speed').options) option.text = `${option.value}x, ${PASS_S * spans / option.value} s a pass`;
  byId('speed').value = 1;
}

function toggle(id, action) {
  byId(id).onclick = ({ currentTarget: pressed }) => {
    pressed.ariaPressed = pressed.ariaPressed !== 'true';
    action(pressed.ariaPressed === 'true');
  };
}

function connect(player, manifest, colours) {
  const { clock, view, cameras, picture } = player;
  byId('play').onclick = () => clock.toggle();
  byId('time').oninput = () => clock.seek(Number(byId('time').value));
  byId('speed').onchange = () => { clock.speed = Number(byId('speed').value); clock.tell(); };
  byId('from').onchange = () => {
    const camera = manifest.cameras.find(({ id }) => id === byId('from').value);
    if (camera) view.enter(camera);
    else view.reset();
    player.request();
  };
  byId('reset').onclick = () => { view.reset(); player.request(); };
  toggle('cameras', (on) => { cameras.shown = on; player.request(); });
  toggle('depth', (on) => { picture.showDepth = on; byId('legend').hidden = !on; player.request(); });
  toggle('compare', (on) => player.compare.want(on));
  byId('wipe').oninput = () => player.request();
  byId('scale').style.background = `linear-gradient(to left, ${colours.join(', ')})`;
  document.addEventListener('keydown', (event) => {
    const own = event.target.closest?.('button, select, a, [readonly]');
    if (event.key !== ' ' || own || byId('play').disabled) return;
    event.preventDefault();
    clock.toggle();
  });
}

const isOn = (id) => byId(id).ariaPressed === 'true';

/** Say a line over the picture: what was done goes after a while, a fault stays until the next line. */
function tell(text, stays = false) {
  byId('told').textContent = text;
  clearTimeout(tell.gone);
  if (!stays) tell.gone = setTimeout(() => { byId('told').textContent = ''; }, SAID_MS);
}

const press = (id, on) => { if (on !== undefined && isOn(id) !== on) byId(id).click(); };

/** Show the view that the address tells, if it tells one. */
function openLinked(player, manifest, parts) {
  const text = location.hash.slice(1);
  if (!text) return;
  const { clock, compare, view } = player;
  try {
    const speeds = [...byId('speed').options].map((option) => option.value);
    const state = parts.stateOf(text, manifest, speeds);
    if (state.camera || state.pose) parts.restore(view, state);
    for (const id of ['depth', 'cameras']) press(id, state[id]);
    if (state.speed) { byId('speed').value = state.speed; byId('speed').onchange(); }
    if (state.instant_s !== undefined) clock.instant_s = state.instant_s;
    if (state.compare !== undefined) { compare.share = state.compare; compare.want(true); }
    tell('');
    player.request();
  } catch (error) {
    if (!(error instanceof parts.LinkError)) throw error;
    tell(`The link's view is not shown. ${error.message}`, true);
  }
}

/** Let a person save the picture and link to the view. */
function share(player, manifest, parts) {
  const { clock, compare, picture, view } = player;
  byId('share').onclick = async () => {
    const state = { ...parts.placeOf(view), instant_s: clock.instant_s, speed: byId('speed').value, depth: isOn('depth'), cameras: isOn('cameras'), compare: compare.wanted ? compare.share : null };
    history.replaceState(null, '', `#${parts.fragment(state)}`);
    byId('link').value = location.href;
    byId('shared').hidden = false;
    const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
    if (!copied) byId('link').select();
    tell(copied ? 'The link is copied.' : 'This browser copies nothing for pages; copy the link from its field.', !copied);
  };
  byId('save').onclick = async () => {
    picture.draw(view, player.size); // a canvas forgets what it shows once it is shown
    const made = parts.composed(byId('picture'), view, player.size, compare);
    const shown = [isOn('depth') && 'depth', compare.visible && 'compared'].filter(Boolean);
    const name = parts.fileName(byId('job').textContent, view.camera, clock.u * clock.lasts_ms, shown);
    await parts.save(made, name);
    tell(`${name} is saved.`);
  };
  window.onhashchange = () => openLinked(player, manifest, parts);
  openLinked(player, manifest, parts);
}

async function loadParts() {
  await import('./vendor/spark.js').catch((error) => {
    throw new SceneError(`found no renderer (${error.message}); run "make viewer" and reload this page`);
  });
  const modules = ['view', 'cameras', 'splats', 'picture', 'compare', 'controls', 'sharing', 'spans', 'trust'].map((name) => import(`./${name}.js`));
  return Object.assign({}, ...await Promise.all(modules));
}

async function start() {
  const job = new URLSearchParams(location.search).get('job');
  if (!job) throw new SceneError('found no job in the address, expected ?job=ID; open the viewer from a job on the first page');
  byId('job').textContent = job;
  headingOf(job).then((name) => { byId('job').textContent = name; document.title = `${name} · spike4dgs`; });
  const parts = await loadParts();
  const lack = parts.lacking();
  if (lack) throw new SceneError(lack);
  say('Loading');
  const scene = await loadScene(job, (got, all) => say(`Loading ${(got / 1e6).toFixed(1)} of ${(all / 1e6).toFixed(1)} MB`));
  fillForm(scene.manifest, parts.nameOf);
  const player = new Player(job, scene, parts);
  connect(player, scene.manifest, parts.DEPTH_COLOURS);
  byId('controls').disabled = false;
  share(player, scene.manifest, parts);
  say('');
  player.request();
}

start().catch((error) => {
  say(error instanceof SceneError ? error.message : `The viewer failed: ${error.message}`, true);
  if (!(error instanceof SceneError)) throw error;
});
