// The parts of three.js and Spark that the viewer uses; esbuild bundles them into vendor/spark.js.
export { SparkRenderer, SplatMesh, dyno } from '@sparkjsdev/spark';
export {
  BufferGeometry, Color, DataTexture, Float32BufferAttribute, FloatType, HalfFloatType, LineBasicMaterial, LineSegments,
  Matrix4, Mesh, NearestFilter, PerspectiveCamera, Quaternion, RawShaderMaterial, RGBAFormat, Scene, ShaderMaterial,
  Vector2, Vector3, WebGLRenderer, WebGLRenderTarget,
} from 'three';
