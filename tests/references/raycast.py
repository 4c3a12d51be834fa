"""Readable twin of the native ray caster: every ray against every shape, in NumPy, nothing left out.

Letters: N rays. A ray is o + t d with d's z equal to 1 in the camera, so t is the depth. Shapes are convex and seen
from outside, so the entry point is all there is to find.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.bodies import KINDS
from acquisition.scenes.raycast import Floats, Frames, SceneArrays
from rigs.camera import Camera

NEAR_M = 1e-4


def trace_reference(
    scene: SceneArrays, camera: Camera, rotations: Floats, positions: Floats, samples: int, *, gain: float = 1.0
) -> Frames:
    """One instant [1, H, W] with the shapes at world_from_shape `rotations` [P, 3, 3], `positions` [P, 3]."""
    steps = (np.arange(samples) + 0.5) / samples
    rays = _Rays(scene, camera, rotations, positions, _pixels(camera, steps))
    light = gain * rays.light(spacing=1 / (camera.fx * samples))
    middle = _Rays(scene, camera, rotations, positions, _pixels(camera, np.array([0.5])))
    shape = (1, camera.height, camera.width)
    return Frames(
        light.reshape(*shape, -1).mean(axis=-1).astype(np.float32),
        np.where(middle.shape < 0, np.nan, middle.depth).reshape(shape).astype(np.float32),
        np.where(middle.shape < 0, 0, scene.ids[middle.shape]).reshape(shape).astype(np.int8),
    )


def _pixels(camera: Camera, steps: Floats) -> Floats:
    """Return where the rays meet the image, (u, v) [N, 2]: `steps` into each pixel both ways, row by row."""
    rows, columns = np.arange(camera.height), np.arange(camera.width)
    v, u, dv, du = np.meshgrid(rows, columns, steps, steps, indexing="ij")
    return np.asarray(np.stack([u + du, v + dv], axis=-1).reshape(-1, 2), dtype=np.float64)


class _Rays:
    """Rays [N] of one camera and what they hit first: `shape` [N] (-1: nothing) at `depth` [N]."""

    def __init__(self, scene: SceneArrays, camera: Camera, rotations: Floats, positions: Floats, pixels: Floats):
        self.scene, self.rotations, self.positions = scene, rotations, positions
        u, v = pixels.T
        in_camera = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
        self.origin = camera.center
        self.direction = in_camera @ camera.cam_from_rig.rotation
        entries = [self._entry(k, self.origin, self.direction, NEAR_M) for k in range(len(scene.shapes))]
        self.depth = np.min(entries, axis=0)
        self.shape = np.where(np.isfinite(self.depth), np.argmin(entries, axis=0), -1)

    def _entry(self, k: int, origin: Floats, direction: Floats, least: float) -> Floats:
        o = (origin - self.positions[k]) @ self.rotations[k]
        d = direction @ self.rotations[k]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = _ENTRIES[KINDS[int(self.scene.shapes[k, 0])]](self.scene.shapes[k, 1:4], o, d)
            return np.where(t > least, t, np.inf)

    def light(self, spacing: float) -> Floats:
        """Spikes per tick of each ray [N], at one metre's distance `spacing` metres from the next."""
        scene, uneven = self.scene, self.scene.uneven
        out = np.full(len(self.depth), scene.background)
        for k in range(len(scene.shapes)):
            hit = self.shape == k
            if not hit.any():
                continue
            point = self.origin + self.depth[hit, None] * self.direction[hit]
            normal, face, uv = _surface(scene.shapes[k], (point - self.positions[k]) @ self.rotations[k])
            outward = normal @ self.rotations[k].T
            towards = np.where((outward * self.direction[hit]).sum(axis=-1) > 0, -1, 1)
            facing = np.maximum(0, towards * (outward @ scene.sun))
            shaded = self._shaded(k, point)
            low, high = scene.shapes[k, 8:10]
            across = abs((outward * self.direction[hit]).sum(axis=-1)) / np.linalg.norm(self.direction[hit], axis=-1)
            with np.errstate(divide="ignore"):
                spacing_m = self.depth[hit] * spacing / np.sqrt(across)
            albedo = low + (high - low) * _texel(scene, scene.shapes[k], face, uv, spacing_m)
            white = scene.white * np.clip(point @ np.array(uneven.slope) + uneven.offset, uneven.least, 1)
            out[hit] = white * albedo * (scene.ambient + (1 - scene.ambient) * np.where(shaded, 0, facing))
        return out

    def _shaded(self, own: int, point: Floats) -> NDArray[np.bool_]:
        sun = np.broadcast_to(self.scene.sun, point.shape)
        others = (k for k in range(len(self.scene.shapes)) if k != own)
        return np.any([np.isfinite(self._entry(k, point, sun, 0.0)) for k in others] or [np.zeros(len(point))], axis=0)


def _slab(half: Floats | float, o: Floats, d: Floats) -> tuple[Floats, Floats]:
    t = np.stack([(-half - o) / d, (half - o) / d])
    return t.min(axis=0), t.max(axis=0)


def _rectangle(size: Floats, o: Floats, d: Floats) -> Floats:
    t = -o[..., 2] / d[..., 2]
    at = o + t[:, None] * d
    return np.where((abs(at[:, 0]) <= size[0]) & (abs(at[:, 1]) <= size[1]), t, np.inf)


def _box(size: Floats, o: Floats, d: Floats) -> Floats:
    enter, leave = _slab(size, o, d)
    return np.where(enter.max(axis=-1) <= leave.min(axis=-1), enter.max(axis=-1), np.inf)


def _sphere(size: Floats, o: Floats, d: Floats) -> Floats:
    dd, od = (d * d).sum(axis=-1), (o * d).sum(axis=-1)
    root = np.sqrt(od**2 - dd * ((o * o).sum(axis=-1) - size[0] ** 2))
    return np.nan_to_num((-od - root) / dd, nan=np.inf)


def _cylinder(size: Floats, o: Floats, d: Floats) -> Floats:
    dd, od = (d[..., :2] ** 2).sum(axis=-1), (o[..., :2] * d[..., :2]).sum(axis=-1)
    inside = (o[..., :2] ** 2).sum(axis=-1) - size[0] ** 2
    root = np.sqrt(od**2 - dd * inside)
    enter, leave = _slab(size[1], o[..., 2], d[..., 2])
    along = dd == 0  # parallel to the axis: only the caps can be entered
    enter = np.where(along, np.where(inside > 0, np.nan, enter), np.maximum(enter, (-od - root) / dd))
    leave = np.where(along, leave, np.minimum(leave, (-od + root) / dd))
    return np.where(enter <= leave, enter, np.inf)


_ENTRIES = {"rectangle": _rectangle, "box": _box, "sphere": _sphere, "cylinder": _cylinder}


def _surface(row: Floats, at: Floats) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Outward normal [N, 3], face [N] and texture coordinates [N, 2] in metres of points on a shape, in its frame."""
    kind, size = KINDS[int(row[0])], row[1:4]
    if kind == "rectangle":
        return np.broadcast_to([0.0, 0.0, 1.0], at.shape), np.zeros(len(at), np.int64), at[:, :2]
    if kind == "cylinder":
        cap = abs(at[:, 2]) >= size[1] * (1 - 1e-9)
        round_uv = np.stack([np.arctan2(at[:, 1], at[:, 0]) * size[0], at[:, 2]], axis=-1)
        up = np.sign(at[:, 2])[:, None] * [0.0, 0.0, 1.0]
        normal = np.where(cap[:, None], up, at * [1 / size[0], 1 / size[0], 0])
        return normal, np.where(cap, np.where(at[:, 2] > 0, 1, 2), 0), np.where(cap[:, None], at[:, :2], round_uv)
    scaled = at / size if kind == "box" else at
    axis = abs(scaled).argmax(axis=-1)
    rows = np.arange(len(at))
    sign = np.where(scaled[rows, axis] > 0, 1, -1)
    normal = at / size[0] if kind == "sphere" else sign[:, None] * np.eye(3)[axis]
    others = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    return normal, 2 * axis + (sign < 0), np.take_along_axis(at, others, axis=-1)


def _texel(scene: SceneArrays, row: Floats, face: NDArray[np.int64], uv: Floats, spacing_m: Floats) -> Floats:
    """The texture, bilinear and periodic, between the two levels whose texels are about as wide as `spacing_m` [N].

    Faces show parts 0.37 of the texture apart.
    """
    pyramid, last = scene.pyramid, len(scene.pyramid) - 1
    at = uv * row[5] + row[6:8] + 0.37 * len(pyramid[0][0]) * face[:, None]
    wide = np.maximum(1, spacing_m * row[5]) if last else np.ones(len(at))
    level = np.minimum(np.frexp(np.minimum(wide, 2.0**30))[1] - 1, last)  # the whole part of its logarithm
    seen = np.stack([_bilinear(image[int(row[4])], (at + 0.5) / 2**k - 0.5) for k, image in enumerate(pyramid)])
    weight = np.where(level == last, 0, wide / 2.0**level - 1)
    fine, coarse = (np.take_along_axis(seen, np.minimum(level + step, last)[None], axis=0)[0] for step in (0, 1))
    return fine + np.where(weight > 0, weight * (coarse - fine), 0)


def _bilinear(image: NDArray[np.float32], at: Floats) -> Floats:
    """Values [N] at `at` [N, 2] texels (u, v) of a periodic image whose texel centres are whole numbers."""
    size, values = len(image), image.astype(np.float64)
    corner = np.floor(at).astype(np.int64)
    wu, wv = (at - corner).T
    (x0, y0), (x1, y1) = corner.T % size, (corner.T + 1) % size
    top = (1 - wu) * values[y0, x0] + wu * values[y0, x1]
    return (1 - wv) * top + wv * ((1 - wu) * values[y1, x0] + wu * values[y1, x1])
