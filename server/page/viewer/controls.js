// Mouse, touch and keys on the picture: orbit, move and zoom.
const RADIANS_PER_PX = 0.006;
const STEP = 0.08; // radians of one arrow key
const KEYS = {
  ArrowLeft: (view) => view.orbit(STEP, 0),
  ArrowRight: (view) => view.orbit(-STEP, 0),
  ArrowUp: (view) => view.orbit(0, STEP),
  ArrowDown: (view) => view.orbit(0, -STEP),
  '+': (view) => view.zoom(0.9),
  '=': (view) => view.zoom(0.9),
  '-': (view) => view.zoom(1 / 0.9),
};
const SHIFTED = { ArrowLeft: [20, 0], ArrowRight: [-20, 0], ArrowUp: [0, 20], ArrowDown: [0, -20] };

const between = ([a, b]) => ({ x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) });

function drag(view, pointers, event, size) {
  const before = pointers.get(event.pointerId);
  const now = { x: event.clientX, y: event.clientY };
  const [dx, dy] = [now.x - before.x, now.y - before.y];
  if (pointers.size === 2) {
    const was = between([...pointers.values()]);
    pointers.set(event.pointerId, now);
    const is = between([...pointers.values()]);
    view.zoom(Math.max(was.apart, 1) / Math.max(is.apart, 1));
    view.pan(is.x - was.x, is.y - was.y, size());
    return;
  }
  pointers.set(event.pointerId, now);
  if (event.buttons === 2 || event.shiftKey) view.pan(dx, dy, size());
  else view.orbit(dx * RADIANS_PER_PX, dy * RADIANS_PER_PX);
}

/** Let `canvas` steer `view`; `size` gives the canvas in CSS pixels, `changed` is called after each step. */
export function steer(canvas, view, size, changed) {
  const pointers = new Map();
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!pointers.has(event.pointerId)) return;
    drag(view, pointers, event, size);
    changed();
  });
  for (const ending of ['pointerup', 'pointercancel']) {
    canvas.addEventListener(ending, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener('contextmenu', (event) => event.preventDefault());
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    view.zoom(Math.exp(event.deltaY * 0.001));
    changed();
  }, { passive: false });
  canvas.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const shift = event.shiftKey && SHIFTED[event.key];
    if (shift) view.pan(...shift, size());
    else if (event.key in KEYS) KEYS[event.key](view);
    else return;
    event.preventDefault();
    changed();
  });
}
