// The view: a pose in the rig frame (OpenCV axes) and pinhole intrinsics.
import { Matrix4, Quaternion, Vector3 } from './vendor/spark.js';

const OPENGL_FROM_OPENCV = new Quaternion(1, 0, 0, 0); // half a turn about x
const STAND_BACK = [1.3, 1.5, 1.75, 2]; // times the distance to the scene
const ASIDE = [0.12, 0.1]; // radians
const LOWEST = 0.92; // share of the height; below it is room for a camera's name
const NEAREST = 0.1; // times the nearest depth: the least depth that has a colour of its own
const STEEPEST = 0.05; // radians between the line of sight and straight up or down

/** Return {centre, turn}: the camera's centre (m) and rig_from_cam rotation, from cam_from_rig (row-major). */
export function poseOf(camera) {
  const rigFromCam = new Matrix4().set(...camera.cam_from_rig.flat()).invert();
  const pose = { centre: new Vector3(), turn: new Quaternion() };
  rigFromCam.decompose(pose.centre, pose.turn, new Vector3());
  return pose;
}

/** Return the scale, left and top of a camera's picture, whole and centred in a window of CSS pixels. */
export function fit(camera, { width, height }) {
  const scale = Math.min(width / camera.width, height / camera.height);
  return { scale, left: (width - scale * camera.width) / 2, top: (height - scale * camera.height) / 2 };
}

const along = (turn, x, y, z) => new Vector3(x, y, z).applyQuaternion(turn);
const depthOf = (point, { centre, turn }) => point.clone().sub(centre).dot(along(turn, 0, 0, 1));

export class View {
  /** `cameras` as in the manifest; `target` (m) is what the view turns about. */
  constructor(cameras, target) {
    this.cameras = cameras;
    this.middle = new Vector3(...target);
    const poses = cameras.map(poseOf);
    this.up = poses.reduce((sum, pose) => sum.add(along(pose.turn, 0, -1, 0)), new Vector3()).normalize();
    const mean = poses.reduce((sum, pose) => sum.add(pose.centre), new Vector3()).divideScalar(poses.length);
    const distances = poses.map((pose) => pose.centre.distanceTo(mean));
    this.home = cameras[distances.indexOf(Math.min(...distances))];
    this.reset();
  }

  /** Look from behind and beside the rig's middle camera at the scene, with all cameras in sight if possible. */
  reset() {
    for (const back of STAND_BACK) {
      this.enter(this.home);
      this.target.copy(this.middle);
      this.zoom(back);
      this.#look();
      this.orbit(...ASIDE);
      if (this.cameras.every((camera) => this.#sees(poseOf(camera).centre))) return;
    }
  }

  #sees(point) {
    const at = this.project(point, this.lens);
    return at !== null && at.x > 0 && at.y > 0 && at.x < this.lens.width && at.y < LOWEST * this.lens.height;
  }

  /** Take exactly the view of a camera. */
  enter(camera) {
    Object.assign(this, poseOf(camera), { camera, lens: camera });
    const sight = along(this.turn, 0, 0, 1);
    this.target = this.centre.clone().addScaledVector(sight, Math.max(depthOf(this.middle, this), 1e-3));
  }

  #look() {
    const z = this.target.clone().sub(this.centre).normalize();
    const x = z.clone().cross(this.up).normalize();
    this.turn.setFromRotationMatrix(new Matrix4().makeBasis(x, z.clone().cross(x), z));
  }

  /** Return the nearest and farthest depth (m) of the colours: the cameras', `near` and `far`, shifted with the view. */
  depths([near, far]) {
    if (this.camera) return [near, far];
    const moved = depthOf(this.middle, this) - depthOf(this.middle, poseOf(this.home));
    const first = Math.max(near + moved, NEAREST * near);
    return [first, Math.max(far + moved, first + (far - near) / 2)];
  }

  /** Turn about the target, in radians: `right` moves the viewer to the left of the scene, `down` above it. */
  orbit(right, down) {
    this.camera = null;
    const toUp = along(this.turn, 0, 0, 1).angleTo(this.up);
    const pitch = Math.min(Math.max(toUp + down, STEEPEST), Math.PI - STEEPEST) - toUp;
    const turn = new Quaternion().setFromAxisAngle(this.up, -right)
      .multiply(new Quaternion().setFromAxisAngle(along(this.turn, 1, 0, 0), -pitch));
    this.centre.sub(this.target).applyQuaternion(turn).add(this.target);
    this.turn.premultiply(turn);
  }

  /** Move with the target across the line of sight, in CSS pixels at the target's depth. */
  pan(right, down, size) {
    this.camera = null;
    const metres = this.centre.distanceTo(this.target) / (this.lens.fx * fit(this.lens, size).scale);
    const shift = along(this.turn, -right * metres, -down * metres, 0);
    this.centre.add(shift);
    this.target.add(shift);
  }

  /** Multiply the distance to the target. */
  zoom(factor) {
    this.camera = null;
    this.centre.sub(this.target).multiplyScalar(factor).add(this.target);
  }

  /** Set a three.js camera to this view in a window of CSS pixels: pose and projection, principal point included. */
  applyTo(camera, size) {
    camera.matrix.compose(this.centre, this.turn.clone().multiply(OPENGL_FROM_OPENCV), new Vector3(1, 1, 1));
    camera.updateMatrixWorld(true);
    const { fx, fy, cx, cy } = this.#pinhole(size);
    const { near, far } = camera;
    const { width, height } = size;
    camera.projectionMatrix.set(
      2 * fx / width, 0, 1 - 2 * cx / width, 0,
      0, 2 * fy / height, 2 * cy / height - 1, 0,
      0, 0, -(far + near) / (far - near), -2 * far * near / (far - near),
      0, 0, -1, 0,
    );
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  }

  /** Project a point (m, rig frame) to CSS pixels of the window; null if it is behind the viewer. */
  project(point, size) {
    const inCam = point.clone().sub(this.centre).applyQuaternion(this.turn.clone().invert());
    if (inCam.z <= 0) return null;
    const { fx, fy, cx, cy } = this.#pinhole(size);
    return { x: fx * inCam.x / inCam.z + cx, y: fy * inCam.y / inCam.z + cy };
  }

  /** Return the intrinsics of the lens in CSS pixels of a window. */
  #pinhole(size) {
    const { scale, left, top } = fit(this.lens, size);
    const { fx, fy, cx, cy } = this.lens;
    return { fx: scale * fx, fy: scale * fy, cx: left + scale * cx, cy: top + scale * cy };
  }
}
