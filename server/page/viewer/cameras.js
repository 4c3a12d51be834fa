// The rig's cameras over the picture: a frustum and a name each, and in a camera's own view the edge of its picture.
import { BufferGeometry, Float32BufferAttribute, LineBasicMaterial, LineSegments, Scene, Vector3 } from './vendor/spark.js';
import { element } from '../operator/dom.js';
import { fit, poseOf } from './view.js';

const TRAINING = '#4aa8ff'; // both lie on black, in the light and the dark scheme
const HELD_OUT = '#ffb02e';
const LONG = 0.06; // length of a frustum, as a share of the distance from the rig to the scene

export const nameOf = (camera) => camera.held_out ? `${camera.id} (held out)` : camera.id;

function frustum(camera, depth) {
  const { centre, turn } = poseOf(camera);
  const corner = (u, v) => new Vector3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1)
    .multiplyScalar(depth).applyQuaternion(turn).add(centre);
  const { width: w, height: h } = camera;
  const corners = [corner(0, 0), corner(w, 0), corner(w, h), corner(0, h)];
  const roof = [corner(0.35 * w, 0), corner(0.5 * w, -0.2 * h), corner(0.5 * w, -0.2 * h), corner(0.65 * w, 0)];
  const edges = corners.flatMap((one, i) => [centre, one, one, corners[(i + 1) % 4]]);
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new Float32BufferAttribute([...edges, ...roof].flatMap((p) => p.toArray()), 3));
  const material = new LineBasicMaterial({ color: camera.held_out ? HELD_OUT : TRAINING, depthTest: false });
  const lines = new LineSegments(geometry, material);
  lines.frustumCulled = false;
  return { lines, centre };
}

export class Cameras {
  /** `names` and `edge` are elements over the picture: one holds the names, one outlines a camera's picture. */
  constructor({ cameras, centre }, names, edge) {
    this.scene = new Scene();
    this.edge = edge;
    this.shown = true;
    this.items = cameras.map((camera) => {
      const distance = poseOf(camera).centre.distanceTo(new Vector3(...centre));
      const text = camera.held_out ? `${camera.id} held\u00a0out` : camera.id;
      const label = element('span', { className: camera.held_out ? 'held-out' : '', hidden: true }, text);
      return { ...frustum(camera, LONG * distance), label };
    });
    this.scene.add(...this.items.map((item) => item.lines));
    names.append(...this.items.map((item) => item.label));
  }

  /** Put names and edge in their places in this view; the view of a camera shows no frustums. */
  place(view, size) {
    for (const { lines, label, centre } of this.items) {
      lines.visible = this.shown && !view.camera;
      const at = lines.visible ? view.project(centre, size) : null;
      label.hidden = !at || at.x < 0 || at.y < 0 || at.x > size.width || at.y > size.height;
      if (!label.hidden) label.style.transform = `translate(${at.x.toFixed(1)}px, ${at.y.toFixed(1)}px) translate(-50%, .4rem)`;
    }
    this.edge.hidden = !view.camera;
    if (!view.camera) return;
    const { scale, left, top } = fit(view.camera, size);
    const [width, height] = [scale * view.camera.width, scale * view.camera.height];
    Object.assign(this.edge.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px` });
  }
}
