// Draws the Gaussians in linear light, as the renderer that trained them does; then grey or depth colours, then cameras.
import {
  BufferGeometry, Float32BufferAttribute, HalfFloatType, Mesh, NearestFilter, PerspectiveCamera, RawShaderMaterial,
  Scene, SparkRenderer, Vector2, Vector3, WebGLRenderTarget, WebGLRenderer,
} from './vendor/spark.js';

// matplotlib's turbo at thirteen places from far (cold) to near (warm), uniform in inverse depth, as in the report.
export const DEPTH_COLOURS = [
  '#30123b', '#434eba', '#4685fa', '#28bceb', '#1ae4b6', '#55fa76', '#a4fc3c', '#d9e436', '#faba39', '#fb7e21', '#e4450a',
  '#b91e02', '#7a0403',
];
const ALPHA_MAX = 0.99;
const ALPHA_MIN = 1 / 255;
const DILATION_PX2 = 0.3; // of a scene that says none
const REACH = Math.sqrt(2 * Math.log(255)); // standard deviations at which an opaque Gaussian has fallen to ALPHA_MIN

// Red sums intensity, green depth along the axis (1 / gl_FragCoord.w), alpha the absorbed light.
const SPLAT = `
  precision highp float;
  uniform float minAlpha;
  in vec4 vRgba;
  in vec2 vSplatUv;
  out vec4 fragColor;
  void main() {
    float alpha = min(vRgba.a * exp(-0.5 * dot(vSplatUv, vSplatUv)), ${ALPHA_MAX});
    if (alpha < minAlpha) discard;
    fragColor = vec4(vRgba.r, 1.0 / gl_FragCoord.w, 0.0, 1.0) * alpha;
  }`;

const COVER = 'in vec3 position; void main() { gl_Position = vec4(position, 1.0); }';

const DEVELOP = `
  precision highp float;
  uniform highp sampler2D frame;
  uniform bool showDepth;
  uniform vec2 inverseDepths; // near, far
  uniform vec3 colours[${DEPTH_COLOURS.length}];
  out vec4 seen;
  void main() {
    vec4 sum = texelFetch(frame, ivec2(gl_FragCoord.xy), 0);
    vec3 colour = vec3(pow(clamp(sum.r, 0.0, 1.0), 1.0 / 2.2));
    if (showDepth) {
      float warmth = (sum.a / max(sum.g, 1e-6) - inverseDepths.y) / (inverseDepths.x - inverseDepths.y);
      float place = clamp(warmth, 0.0, 1.0) * ${(DEPTH_COLOURS.length - 1).toFixed(1)};
      int below = min(int(place), ${DEPTH_COLOURS.length - 2});
      colour = sum.a < 0.5 ? vec3(0.0) : mix(colours[below], colours[below + 1], place - float(below));
    }
    seen = vec4(colour, 1.0);
  }`;

/** Return in one line what this browser lacks for the viewer, or null. */
export function lacking() {
  const gl = document.createElement('canvas').getContext('webgl2');
  if (!gl) return 'found no WebGL 2; use a current browser and switch its hardware acceleration on';
  const floats = gl.getExtension('EXT_color_buffer_float') ?? gl.getExtension('EXT_color_buffer_half_float');
  gl.getExtension('WEBGL_lose_context')?.loseContext();
  return floats ? null : 'found no floating-point pictures in WebGL 2; use a current browser or another GPU';
}

function developer() {
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new Float32BufferAttribute([-1, -1, 0, 3, -1, 0, -1, 3, 0], 3));
  const colours = DEPTH_COLOURS.map((hex) => new Vector3(...rgb(hex)));
  const uniforms = {
    frame: { value: null }, showDepth: { value: false }, colours: { value: colours }, inverseDepths: { value: new Vector2() },
  };
  const material = new RawShaderMaterial({
    glslVersion: '300 es', vertexShader: COVER, fragmentShader: DEVELOP, uniforms, depthTest: false, depthWrite: false,
  });
  const cover = new Mesh(geometry, material);
  cover.frustumCulled = false;
  const scene = new Scene();
  scene.add(cover);
  return { scene, uniforms };
}

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

/** Draws `mesh` and, over it, the scene `overlay` on the canvas; `request` is called when another frame is due. */
export class Picture {
  constructor(canvas, mesh, overlay, { depth_m: depth, dilation_px2: dilation = DILATION_PX2 }, request) {
    this.canvas = canvas;
    this.overlay = overlay;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, powerPreference: 'high-performance' });
    this.renderer.autoClear = false;
    this.target = new WebGLRenderTarget(1, 1, {
      type: HalfFloatType, minFilter: NearestFilter, magFilter: NearestFilter, depthBuffer: false,
    });
    this.spark = new SparkRenderer({
      renderer: this.renderer, onDirty: request, accumExtSplats: true, sortRadial: false, enableLod: false,
      maxStdDev: REACH, minAlpha: ALPHA_MIN, blurAmount: dilation, maxPixelRadius: 4096, clipXY: 3,
      fragmentShader: SPLAT, depthTest: false,
    });
    this.scene = new Scene();
    this.scene.add(this.spark, mesh);
    this.developer = developer();
    this.camera = new PerspectiveCamera();
    Object.assign(this.camera, { near: 0.02 * depth[0], far: 50 * depth[1], matrixAutoUpdate: false });
  }

  /** Nearest and farthest depth (m) of the colours. */
  set depths([near, far]) { this.developer.uniforms.inverseDepths.value.set(1 / near, 1 / far); }

  set showDepth(value) { this.developer.uniforms.showDepth.value = value; }

  /** True when the last frame was drawn with its Gaussians in order. */
  get settled() { return this.spark.activeSplats > 0 && !this.spark.sorting && !this.spark.sortDirty; }

  /** Fit the pictures to the element around the canvas; return their size in whole CSS pixels. */
  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height);
    this.target.setSize(this.canvas.width, this.canvas.height);
    return { width, height };
  }

  /** Draw one frame from a View. */
  draw(view, size) {
    view.applyTo(this.camera, size);
    this.renderer.setRenderTarget(this.target);
    this.renderer.setClearColor(0, 0);
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    this.renderer.setRenderTarget(null);
    this.developer.uniforms.frame.value = this.target.texture;
    this.renderer.render(this.developer.scene, this.camera);
    this.renderer.render(this.overlay, this.camera);
  }
}
