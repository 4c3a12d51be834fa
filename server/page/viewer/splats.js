// The Gaussians in the form Spark reads: rows in two textures, one for the still ones and one for the moving ones.
// Spans share both: the second has room for the movers of the fullest span, and rows that are not used have no size.
import { DataTexture, FloatType, NearestFilter, RGBAFormat, SplatMesh, dyno } from './vendor/spark.js';
import { ROW, moveRows, storedRows } from './motion.js';

const ROWS_WIDE = 512; // Gaussians in a line of a texture, three texels each

const READ = `
  void readRow(sampler2D still, sampler2D moving, int stillCount, int index, out Gsplat gsplat) {
    bool moves = index >= stillCount;
    int row = moves ? index - stillCount : index;
    ivec2 at = ivec2(3 * (row % ${ROWS_WIDE}), row / ${ROWS_WIDE});
    vec4 place = moves ? texelFetch(moving, at, 0) : texelFetch(still, at, 0);
    vec4 size = moves ? texelFetch(moving, at + ivec2(2, 0), 0) : texelFetch(still, at + ivec2(2, 0), 0);
    gsplat.flags = size.xyz == vec3(0.0) ? 0u : GSPLAT_FLAG_ACTIVE;
    gsplat.index = index;
    gsplat.center = place.xyz;
    gsplat.quaternion = moves ? texelFetch(moving, at + ivec2(1, 0), 0) : texelFetch(still, at + ivec2(1, 0), 0);
    gsplat.scales = size.xyz;
    gsplat.rgba = vec4(vec3(size.w), place.w);
  }`;

function texture(count) {
  const lines = Math.max(1, Math.ceil(count / ROWS_WIDE));
  const made = new DataTexture(new Float32Array(lines * ROWS_WIDE * ROW), 3 * ROWS_WIDE, lines, RGBAFormat, FloatType);
  Object.assign(made, { minFilter: NearestFilter, magFilter: NearestFilter, needsUpdate: true });
  return made;
}

/** Implements SplatSource, Spark's interface for splats that a shader reads. */
class RowSource {
  constructor(scene) {
    const { still, moving, spans } = scene.manifest;
    this.scene = scene;
    this.played = spans ? null : scene; // whose movers are shown
    this.most = spans ? Math.max(...spans.map((span) => span.moving)) : moving;
    this.still = texture(still);
    this.moving = texture(this.most);
    storedRows(scene, 0, still, this.still.image.data);
    if (!spans) storedRows(scene, still, moving, this.moving.image.data);
    this.inputs = {
      still: new dyno.DynoSampler2D({ key: 'still', value: this.still }),
      moving: new dyno.DynoSampler2D({ key: 'moving', value: this.moving }),
      stillCount: new dyno.DynoInt({ key: 'stillCount', value: still }),
    };
  }

  moveTo(u) {
    moveRows(this.played, u, this.moving.image.data);
    this.moving.needsUpdate = true;
  }

  /** Put the movers of a span, and what it changed of the still ones, in place of another's. */
  show(span) {
    const { arrays } = this.scene;
    const { changed, changed_opacities: opacities, changed_intensities: intensities } = span.arrays;
    for (const n of this.played?.arrays.changed ?? []) this.#light(n, arrays.opacities[n], arrays.intensities[n]);
    changed?.forEach((n, c) => this.#light(n, opacities[c], intensities[c]));
    const rows = this.moving.image.data;
    storedRows(span, 0, span.manifest.moving, rows);
    rows.fill(0, span.manifest.moving * ROW);
    this.played = span;
    this.still.needsUpdate = this.moving.needsUpdate = true;
  }

  #light(n, opacity, intensity) {
    const rows = this.still.image.data;
    rows[n * ROW + 3] = opacity;
    rows[n * ROW + 11] = intensity;
  }

  fetchSplat({ index }) {
    const { still, moving, stillCount } = this.inputs;
    const read = new dyno.Dyno({
      inTypes: { index: 'int', still: 'sampler2D', moving: 'sampler2D', stillCount: 'int' },
      outTypes: { gsplat: dyno.Gsplat },
      globals: () => [dyno.defineGsplat, READ],
      statements: ({ inputs: i, outputs: o }) => [`readRow(${i.still}, ${i.moving}, ${i.stillCount}, ${i.index}, ${o.gsplat});`],
    });
    return read.apply({ index, still, moving, stillCount }).gsplat;
  }

  prepareFetchSplat() {}
  getNumSplats() { return this.scene.manifest.still + this.most; }
  hasRgbDir() { return false; }
  getNumSh() { return 0; }
  setMaxSh() {}
  forEachSplat() {}
  dispose() { this.still.dispose(); this.moving.dispose(); }
}

/** Return a mesh of all Gaussians, `moveTo(u)`, which moves them to u in [0, 1], and `show(span)` of a scene of spans. */
export function makeSplats(scene) {
  const source = new RowSource(scene);
  const mesh = new SplatMesh({ splats: source, raycastable: false, editable: false });
  const moveTo = (u) => {
    if (!source.played || source.played.manifest.moving === 0 || source.played.manifest.motion === 'static') return;
    source.moveTo(u);
    mesh.updateVersion();
  };
  const show = (span) => {
    source.show(span);
    mesh.updateVersion();
  };
  moveTo(0);
  return { mesh, moveTo, show };
}
