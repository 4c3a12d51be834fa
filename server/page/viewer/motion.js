// Where every moving Gaussian is at u, a fraction of the clip. Letters: S still, M moving, K keyframes.
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
    mixQuats(rows, at + 4, arrays.key_quats, 4 * a, 4 * b, t);
  }
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
