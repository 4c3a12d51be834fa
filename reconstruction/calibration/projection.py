"""Projects points through lenses to pixels, with every derivative that calibration needs.

Pinhole and OpenCV's distortion (Brown, "Close-range camera calibration", 1971). Letters: C cameras, O observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Floats, Transform, cross_matrices, rotations

LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
PARAMETERS = ("turn_x", "turn_y", "turn_z", "center_x", "center_y", "center_z", *LENS)  # a camera's changes
TURN, CENTER = slice(0, 3), slice(3, 6)
NEAREST_M = 1e-3  # a point nearer than this, or behind, has no picture


@dataclass(frozen=True, eq=False)
class Cameras:
    """C cameras as arrays: rotations [C, 3, 3] (camera from rig), centers [C, 3] in m, lenses [C, 8] as in LENS."""

    rotations: Floats
    centers: Floats
    lenses: Floats

    @classmethod
    def of(cls, cameras: Sequence[Camera]) -> Cameras:
        """Return the cameras of a rig, in order."""
        lenses = [(c.fx, c.fy, c.cx, c.cy, *c.distortion) for c in cameras]
        turns = [c.cam_from_rig.rotation for c in cameras]
        return cls(np.array(turns), np.array([c.center for c in cameras]), np.array(lenses, dtype=np.float64))

    def __len__(self) -> int:
        return len(self.centers)

    def moved(self, steps: Floats) -> Cameras:
        """Return the cameras after steps [C, 14] of PARAMETERS: turns about their own axes, the rest added."""
        turned = rotations(steps[:, TURN]) @ self.rotations
        return Cameras(turned, self.centers + steps[:, CENTER], self.lenses + steps[:, 6:])

    def written_to(self, rig: Rig) -> Rig:
        """Return `rig` with these poses and lenses."""
        found = []
        for camera, rotation, center, lens in zip(rig.cameras, self.rotations, self.centers, self.lenses, strict=True):
            u, _, vt = np.linalg.svd(rotation)  # steps leave it a rotation to rounding; make it one again
            fx, fy, cx, cy, k1, k2, p1, p2 = map(float, lens)
            values = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": (k1, k2, p1, p2)}
            found.append(replace(camera, cam_from_rig=Transform(u @ vt, -(u @ vt) @ center), **values))
        return replace(rig, cameras=tuple(found))


@dataclass(frozen=True, eq=False)
class Projection:
    """Pixels [O, 2], their derivatives by the points [O, 2, 3] and by PARAMETERS [O, 2, 14], and which are `seen` [O].

    What is not in front of its camera is not seen: its pixels and derivatives are zero.
    """

    pixels: Floats
    by_point: Floats
    by_camera: Floats
    seen: np.ndarray


def project(points: Floats, cameras: Cameras, which: np.ndarray) -> Projection:
    """Project points [O, 3] in m in the rig frame, each into the camera of index `which` [O]."""
    turn = cameras.rotations[which]
    inside = (turn @ (points - cameras.centers[which])[:, :, None])[:, :, 0]
    seen = inside[:, 2] > NEAREST_M
    inside = np.where(seen[:, None], inside, (0.0, 0.0, 1.0))
    pixels, by_inside, by_lens = _through(inside, cameras.lenses[which])
    by_turn = -by_inside @ cross_matrices(inside)
    by_point = by_inside @ turn
    by_camera = np.concatenate([by_turn, -by_point, by_lens], axis=2)
    blind = ~seen
    pixels[blind], by_point[blind], by_camera[blind] = 0.0, 0.0, 0.0
    return Projection(pixels, by_point, by_camera, seen)


def _through(inside: Floats, lenses: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the pixels of points [O, 3] in camera axes, and their derivatives by points and by lenses [O, 8]."""
    fx, fy, cx, cy, k1, k2, p1, p2 = lenses.T
    z = inside[:, 2]
    x, y = inside[:, 0] / z, inside[:, 1] / z
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    pixels = np.stack([fx * u + cx, fy * v + cy], axis=1)
    bend = k1 + 2 * k2 * r2  # half the derivative of `radial` by x is x times this
    ux = radial + 2 * bend * x * x + 2 * p1 * y + 6 * p2 * x
    uy = 2 * bend * x * y + 2 * p1 * x + 2 * p2 * y
    vx = uy
    vy = radial + 2 * bend * y * y + 6 * p1 * y + 2 * p2 * x
    rows = [np.stack([a, b, -(a * x + b * y)], axis=1) / z[:, None] for a, b in ((ux, uy), (vx, vy))]
    by_inside = np.stack([fx[:, None] * rows[0], fy[:, None] * rows[1]], axis=1)
    none, one = np.zeros_like(x), np.ones_like(x)
    by_u = (u, none, one, none, fx * x * r2, fx * x * r2**2, fx * 2 * x * y, fx * (r2 + 2 * x * x))
    by_v = (none, v, none, one, fy * y * r2, fy * y * r2**2, fy * (r2 + 2 * y * y), fy * 2 * x * y)
    return pixels, by_inside, np.stack([np.stack(by_u, axis=1), np.stack(by_v, axis=1)], axis=1)
