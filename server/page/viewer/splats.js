// The Gaussians in the form Spark reads: rows in two textures, one for the still ones and one for the moving ones.
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
    gsplat.flags = GSPLAT_FLAG_ACTIVE;
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
    const { still, moving } = scene.manifest;
    this.scene = scene;
    this.still = texture(still);
    this.moving = texture(moving);
    storedRows(scene, 0, still, this.still.image.data);
    storedRows(scene, still, moving, this.moving.image.data);
    this.inputs = {
      still: new dyno.DynoSampler2D({ key: 'still', value: this.still }),
      moving: new dyno.DynoSampler2D({ key: 'moving', value: this.moving }),
      stillCount: new dyno.DynoInt({ key: 'stillCount', value: still }),
    };
  }

  moveTo(u) {
    moveRows(this.scene, u, this.moving.image.data);
    this.moving.needsUpdate = true;
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
  getNumSplats() { return this.scene.manifest.count; }
  hasRgbDir() { return false; }
  getNumSh() { return 0; }
  setMaxSh() {}
  forEachSplat() {}
  dispose() { this.still.dispose(); this.moving.dispose(); }
}

/** Return a mesh of all Gaussians, and `moveTo(u)`, which moves them to u in [0, 1]. */
export function makeSplats(scene) {
  const source = new RowSource(scene);
  const mesh = new SplatMesh({ splats: source, raycastable: false, editable: false });
  const moveTo = (u) => {
    if (scene.manifest.moving === 0 || scene.manifest.motion === 'static') return;
    source.moveTo(u);
    mesh.updateVersion();
  };
  moveTo(0);
  return { mesh, moveTo };
}
