// What the viewer uses of three.js and Spark; esbuild makes one file of it, vendor/spark.js.
export { SparkRenderer, SplatMesh, dyno } from '@sparkjsdev/spark';
export {
  BufferGeometry, Color, DataTexture, Float32BufferAttribute, FloatType, HalfFloatType, LineBasicMaterial, LineSegments,
  Matrix4, Mesh, NearestFilter, PerspectiveCamera, Quaternion, RawShaderMaterial, RGBAFormat, Scene, ShaderMaterial,
  Vector2, Vector3, WebGLRenderer, WebGLRenderTarget,
} from 'three';
