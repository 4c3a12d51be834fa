"""Projects points through lenses to pixels, with every derivative that calibration needs.

The lenses are those of `rigs.lens`. Letters: C cameras, O observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigs.camera import Camera
from rigs.lens import Lens, bent_by_fisheye, bent_by_opencv, fisheye_angles, shortened
from rigs.rig import Rig
from rigs.transform import Floats, Transform, cross_matrices, rotations

LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
PARAMETERS = ("turn_x", "turn_y", "turn_z", "center_x", "center_y", "center_z", *LENS)  # a camera's changes
BENDS = slice(4, 9)  # of a lens; a fisheye has its k1 k2 k3 k4 here, and nothing in the last place
TURN, CENTER = slice(0, 3), slice(3, 6)
NEAREST_M = 1e-3  # a point nearer than this, or behind, has no picture


@dataclass(frozen=True, eq=False)
class Cameras:
    """C cameras as arrays: rotations [C, 3, 3] (camera from rig), centers [C, 3] in m, lenses [C, 9] as in LENS.

    `fisheye` [C]: which of them are fisheyes.
    """

    rotations: Floats
    centers: Floats
    lenses: Floats
    fisheye: NDArray[np.bool_]

    @classmethod
    def of(cls, cameras: Sequence[Camera]) -> Cameras:
        """Return the cameras of a rig, in order."""
        lenses = [(c.fx, c.fy, c.cx, c.cy, *bends_of(c)) for c in cameras]
        turns, centers = [c.cam_from_rig.rotation for c in cameras], [c.center for c in cameras]
        fisheye = np.array([c.lens_model == "fisheye" for c in cameras])
        return cls(np.array(turns), np.array(centers), np.array(lenses, dtype=np.float64), fisheye)

    def __len__(self) -> int:
        return len(self.centers)

    def slopes(self, pixels: Floats, which: np.ndarray) -> Floats:
        """Return where places [O, 2] in px look from the cameras `which` [O]; beyond a fold as a pinhole looks."""
        places = (pixels - self.lenses[which, 2:4]) / self.lenses[which, :2]
        for number in np.flatnonzero(self.fisheye | self.lenses[:, BENDS].any(axis=1)):
            own, k = which == number, tuple(self.lenses[number, BENDS])
            lens = Lens("fisheye", k[:4]) if self.fisheye[number] else Lens("opencv", k)
            straight = lens.straightened(places[own])
            places[own] = np.where(np.isfinite(straight), straight, places[own])
        return places

    def moved(self, steps: Floats) -> Cameras:
        """Return the cameras after steps [C, 15] of PARAMETERS: turns about their own axes, the rest added."""
        turned = rotations(steps[:, TURN]) @ self.rotations
        return Cameras(turned, self.centers + steps[:, CENTER], self.lenses + steps[:, 6:], self.fisheye)

    def written_to(self, rig: Rig) -> Rig:
        """Return `rig` with these poses and lenses."""
        found = []
        for camera, rotation, center, lens in zip(rig.cameras, self.rotations, self.centers, self.lenses, strict=True):
            u, _, vt = np.linalg.svd(rotation)  # steps leave it a rotation to rounding; make it one again
            fx, fy, cx, cy, *bends = map(float, lens)
            values = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": shortened(tuple(bends))}
            found.append(replace(camera, cam_from_rig=Transform(u @ vt, -(u @ vt) @ center), **values))
        return replace(rig, cameras=tuple(found))


def bends_of(camera: Camera) -> Floats:
    """Return the coefficients of a camera's lens [5], with a zero where it has but four."""
    return np.array((*camera.distortion, 0.0)[:5], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Projection:
    """Pixels [O, 2], their derivatives by the points [O, 2, 3] and by PARAMETERS [O, 2, 15], and which are `seen` [O].

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
    pixels, by_inside, by_lens = _through(inside, cameras.lenses[which], cameras.fisheye[which])
    by_turn = -by_inside @ cross_matrices(inside)
    by_point = by_inside @ turn
    by_camera = np.concatenate([by_turn, -by_point, by_lens], axis=2)
    blind = ~seen
    pixels[blind], by_point[blind], by_camera[blind] = 0.0, 0.0, 0.0
    return Projection(pixels, by_point, by_camera, seen)


def _through(inside: Floats, lenses: Floats, fisheye: NDArray[np.bool_]) -> tuple[Floats, Floats, Floats]:
    """Return the pixels of points [O, 3] in camera axes, and their derivatives by points and by lenses [O, 9]."""
    slopes, focal, bends = inside[:, :2] / inside[:, 2:], lenses[:, :2], lenses[:, BENDS]
    places, by_slopes = bent_by_opencv(slopes, tuple(bends.T))
    by_bends = _by_opencv(slopes)
    if fisheye.any():
        round_places, by_round = bent_by_fisheye(slopes[fisheye], tuple(bends[fisheye, :4].T))
        places[fisheye], by_slopes[fisheye], by_bends[fisheye] = round_places, by_round, _by_fisheye(slopes[fisheye])
    by_inside = np.concatenate([by_slopes, -(by_slopes @ slopes[:, :, None])], axis=2) / inside[:, 2, None, None]
    by_focal = places[:, :, None] * np.eye(2)
    by_center = np.broadcast_to(np.eye(2), by_focal.shape)
    by_lens = np.concatenate([by_focal, by_center, focal[:, :, None] * by_bends], axis=2)
    return focal * places + lenses[:, 2:4], focal[:, :, None] * by_inside, by_lens


def _by_opencv(slopes: Floats) -> Floats:
    """Return the derivatives of bent places by k1 k2 p1 p2 k3 [O, 2, 5]."""
    x, y = slopes.T
    square = x * x + y * y
    by_u = (x * square, x * square**2, 2 * x * y, square + 2 * x * x, x * square**3)
    by_v = (y * square, y * square**2, square + 2 * y * y, 2 * x * y, y * square**3)
    return np.stack([np.stack(by_u, axis=1), np.stack(by_v, axis=1)], axis=1)


def _by_fisheye(slopes: Floats) -> Floats:
    """Return the derivatives of bent places by k1 k2 k3 k4 and a fifth that does nothing [O, 2, 5]."""
    angle, ratio, _ = fisheye_angles(slopes)
    powers = angle[:, None] ** np.array([2, 4, 6, 8])
    powers = np.append(powers, np.zeros((len(powers), 1)), axis=1)
    return slopes[:, :, None] * (ratio[:, None] * powers)[:, None]
