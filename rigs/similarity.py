"""Similarities: cameras alone leave open where a scene lies, how it is turned and how large it is."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from rigs.errors import RigError
from rigs.rig import Rig
from rigs.transform import Floats, Transform


@dataclass(frozen=True, eq=False)
class Similarity:
    """`x_in_target = scale * rotation @ x_in_source + translation`."""

    scale: float
    rotation: Floats
    translation: Floats

    def apply(self, points: ArrayLike) -> Floats:
        """Carry points [..., 3] of the source frame into the target frame."""
        return self.scale * np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation

    def carry(self, cam_from_source: Transform) -> Transform:
        """Return the camera's pose in the target frame; distances along its own axes stay in metres."""
        rotation = cam_from_source.rotation @ self.rotation.T
        return Transform(rotation, -rotation @ self.apply(cam_from_source.center))

    def carry_rig(self, rig: Rig) -> Rig:
        """Return `rig` with every camera in the target frame."""
        cameras = tuple(replace(c, cam_from_rig=self.carry(c.cam_from_rig)) for c in rig.cameras)
        return replace(rig, cameras=cameras)


def align(source: Rig, target: Rig) -> Similarity:
    """Find the similarity that best lays the cameras of `source` on those of the same ids of `target`.

    The rotation is the chordal mean of the turns between the cameras' axes (Hartley et al., "Rotation averaging", IJCV
    2013), which also holds for cameras in a line. Scale and translation then fit the centres by least squares. A single
    camera, or cameras at one place, keep their scale. Raises RigError where no id is shared.
    """
    shared = [c for c in source.ids if c in target.ids]
    if not shared:
        raise RigError(f"found no camera of rig {source.name} in rig {target.name}", "the same ids")
    pairs = [(source.camera(c), target.camera(c)) for c in shared]
    turns = sum(b.cam_from_rig.rotation.T @ a.cam_from_rig.rotation for a, b in pairs)
    u, _, vt = np.linalg.svd(turns)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    a = np.array([one.center for one, _ in pairs]) @ rotation.T
    b = np.array([other.center for _, other in pairs])
    spread_a, spread_b = a - a.mean(axis=0), b - b.mean(axis=0)
    variance = float((spread_a**2).sum())
    covariance = float((spread_a * spread_b).sum())
    scale = covariance / variance if variance > 0 and covariance > 0 else 1.0
    return Similarity(scale, rotation, b.mean(axis=0) - scale * a.mean(axis=0))
