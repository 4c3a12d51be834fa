// Where every moving Gaussian is at u, a fraction of the clip. Letters: S still, M moving, K keyframes, B bodies, P knots.
// A row is three texels of four numbers: x y z opacity, qx qy qz qw, sx sy sz intensity.
export const ROW = 12;

/** Write the rows [count, 12] of the stored Gaussians from `first` on into `rows`, new ones by default. */
export function storedRows({ arrays }, first, count, rows = new Float32Array(count * ROW)) {
  for (let i = 0; i < count; i++) {
    const n = first + i;
    const at = i * ROW;
    rows.set(arrays.means.subarray(3 * n, 3 * n + 3), at);
    rows[at + 3] = arrays.opacities[n];
    setQuat(rows, at + 4, arrays.quats_wxyz, 4 * n);
    rows.set(arrays.scales.subarray(3 * n, 3 * n + 3), at + 8);
    rows[at + 11] = arrays.intensities[n];
  }
  return rows;
}

/** Move `rows` [M, 12], made by storedRows, to u in [0, 1]. */
export function moveRows(scene, u, rows) {
  if (scene.manifest.motion === 'polynomial') polynomial(scene, u, rows);
  else if (scene.manifest.motion === 'keyframes') betweenKeys(scene, u, rows);
  else if (scene.manifest.motion === 'bodies') riding(scene, u, rows);
  return rows;
}

/** mean + v s + a s^2/2 + j s^3/6 with s = u - instant, the opacity times exp(-(s/duration)^2/2). */
function polynomial({ manifest: { still, moving }, arrays }, u, rows) {
  const { means, opacities, velocities, accelerations, jerks, instants, durations } = arrays;
  for (let m = 0; m < moving; m++) {
    const at = m * ROW;
    const s = u - instants[m];
    for (let axis = 0; axis < 3; axis++) {
      const k = 3 * m + axis;
      const bend = (accelerations ? accelerations[k] * s * s / 2 : 0) + (jerks ? jerks[k] * s * s * s / 6 : 0);
      rows[at + axis] = means[3 * (still + m) + axis] + velocities[k] * s + bend;
    }
    rows[at + 3] = opacities[still + m] * Math.exp(-((s / durations[m]) ** 2) / 2);
  }
}

/** Key k lies at u = k / (K - 1); between keys all is linear, quaternions the shorter way round and normalised. */
function betweenKeys({ manifest: { moving, keyframes }, arrays }, u, rows) {
  const place = Math.min(Math.max(u, 0), 1) * (keyframes - 1);
  const before = Math.min(Math.floor(place), Math.max(keyframes - 2, 0));
  const after = Math.min(before + 1, keyframes - 1);
  const t = place - before;
  for (let m = 0; m < moving; m++) {
    const [a, b, at] = [before * moving + m, after * moving + m, m * ROW];
    mix(rows, at, arrays.key_means, 3, a, b, t);
    mix(rows, at + 3, arrays.key_opacities, 1, a, b, t);
    if (arrays.key_scales) mix(rows, at + 8, arrays.key_scales, 3, a, b, t);
    if (arrays.key_intensities) mix(rows, at + 11, arrays.key_intensities, 1, a, b, t);
    mixQuats(rows, at + 4, arrays.key_quats, 4 * a, 4 * b, t);
  }
}

/** Each body carries and turns its own, which may drift beside it; the others go straight on, as a polynomial does. */
function riding(scene, u, rows) {
  const { manifest: { still, moving, bodies: count }, arrays } = scene;
  polynomial(scene, u, rows);
  const poses = posesAt(scene, u);
  const local = new Float32Array(4);
  for (let m = 0; m < moving; m++) {
    const body = arrays.bodies[m];
    if (body >= count) continue;
    place(rows, m * ROW, poses, 7 * body, arrays.means, 3 * (still + m));
    const s = u - arrays.instants[m];
    for (let axis = 0; axis < 3; axis++) rows[m * ROW + axis] += arrays.velocities[3 * m + axis] * s;
    setQuat(local, 0, arrays.quats_wxyz, 4 * (still + m));
    turn(rows, m * ROW + 4, poses, 7 * body, local);
  }
}

/** Return the poses [B, 7] at u, a unit quaternion xyzw and a centre each: Catmull-Rom's cubic through even knots. */
function posesAt({ manifest: { bodies: count, knots }, arrays }, u) {
  const weights = knotWeights(Math.min(Math.max(u, 0), 1), knots);
  const poses = new Float32Array(7 * count);
  const quat = [0, 0, 0, 0];
  for (let b = 0; b < count; b++) {
    quat.fill(0);
    weights.forEach((weight, p) => {
      const knot = b * knots + p;
      for (let i = 0; i < 4; i++) quat[i] += weight * arrays.knot_quats[4 * knot + i];
      for (let i = 0; i < 3; i++) poses[7 * b + 4 + i] += weight * arrays.knot_centers[3 * knot + i];
    });
    setQuat(poses, 7 * b, quat, 0);
  }
  return poses;
}

/** Return the weights [P] of the knots at u, as if the first and the last interval went on straight. */
function knotWeights(u, knots) {
  const weights = new Float64Array(knots);
  if (knots === 1) return weights.fill(1);
  const left = Math.min(Math.floor(u * (knots - 1)), knots - 2);
  const s = u * (knots - 1) - left;
  const cubic = [-s + 2 * s ** 2 - s ** 3, 2 - 5 * s ** 2 + 3 * s ** 3, s + 4 * s ** 2 - 3 * s ** 3, s ** 3 - s ** 2];
  cubic.forEach((twice, k) => {
    const [knot, weight] = [left - 1 + k, twice / 2];
    if (knot < 0) [weights[0], weights[1]] = [weights[0] + 2 * weight, weights[1] - weight];
    else if (knot >= knots) [weights[knots - 1], weights[knots - 2]] = [weights[knots - 1] + 2 * weight, weights[knots - 2] - weight];
    else weights[knot] += weight;
  });
  return weights;
}

/** rows[at..] = q v q* + c, with q = xyzw and c from poses[p..], and v from means[n..]. */
function place(rows, at, poses, p, means, n) {
  const [a, b, c] = [means[n], means[n + 1], means[n + 2]];
  const [x, y, z, w] = [poses[p], poses[p + 1], poses[p + 2], poses[p + 3]];
  const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
  rows[at] = a + w * tx + y * tz - z * ty + poses[p + 4];
  rows[at + 1] = b + w * ty + z * tx - x * tz + poses[p + 5];
  rows[at + 2] = c + w * tz + x * ty - y * tx + poses[p + 6];
}

/** rows[at..] = q r, quaternions xyzw, q from poses[p..]: turned by r, then by q. */
function turn(rows, at, poses, p, r) {
  const [x, y, z, w] = [poses[p], poses[p + 1], poses[p + 2], poses[p + 3]];
  rows[at] = w * r[0] + x * r[3] + y * r[2] - z * r[1];
  rows[at + 1] = w * r[1] - x * r[2] + y * r[3] + z * r[0];
  rows[at + 2] = w * r[2] + x * r[1] - y * r[0] + z * r[3];
  rows[at + 3] = w * r[3] - x * r[0] - y * r[1] - z * r[2];
}

function mix(rows, at, keys, width, a, b, t) {
  for (let i = 0; i < width; i++) rows[at + i] = keys[width * a + i] * (1 - t) + keys[width * b + i] * t;
}

const wxyz = [0, 0, 0, 0];

function mixQuats(rows, at, keys, a, b, t) {
  let dot = 0;
  for (let i = 0; i < 4; i++) dot += keys[a + i] * keys[b + i];
  for (let i = 0; i < 4; i++) wxyz[i] = keys[a + i] * (1 - t) + keys[b + i] * (dot < 0 ? -t : t);
  setQuat(rows, at, wxyz, 0);
}

function setQuat(rows, at, quats, from) {
  const length = Math.hypot(quats[from], quats[from + 1], quats[from + 2], quats[from + 3]);
  if (length > 0) for (let i = 0; i < 4; i++) rows[at + (i + 3) % 4] = quats[from + i] / length;
  else rows.set([0, 0, 0, 1], at);
}
