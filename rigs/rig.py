"""A rig: cameras fixed to one another on one clock."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.errors import RigError

Poses = Literal["calibrated", "nominal"]


@dataclass(frozen=True)
class Calibration:
    """Origin of calibrated poses: an ISO date, the RMS residual in pixels, the standard deviation of the rotations."""

    date: str
    residual_px: float
    rotation_sd_deg: float


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras in row-major order, their tick rate in Hz, and whether their poses are calibrated or nominal.

    `first_tick` is the tick of plane 0 of the streams that come with the rig; no rig file has it.
    Raises RigError for no cameras, a repeated id, or a tick rate that is not positive.
    """

    name: str
    tick_rate_hz: float
    cameras: tuple[Camera, ...]
    poses: Poses = "calibrated"
    calibration: Calibration | None = None
    first_tick: int = 0

    def __post_init__(self) -> None:
        RigClock(self.tick_rate_hz)
        if not self.cameras:
            raise RigError("found no cameras", "at least one", where=f"rig {self.name}")
        repeated = {c for c in self.ids if self.ids.count(c) > 1}
        if repeated:
            found = f"found {', '.join(sorted(repeated))} twice or more"
            raise RigError(found, do="name each camera once", where=f"rig {self.name}")
        if self.poses not in ("calibrated", "nominal"):
            raise RigError(f"found poses {self.poses!r}", "calibrated or nominal", where=f"rig {self.name}")

    @property
    def ids(self) -> tuple[str, ...]:
        """The cameras' ids, in order."""
        return tuple(camera.id for camera in self.cameras)

    @property
    def clock(self) -> RigClock:
        """The clock all cameras are stated on."""
        return RigClock(self.tick_rate_hz, self.first_tick)

    def camera(self, camera_id: str) -> Camera:
        """Return the camera named `camera_id`; raises RigError listing the known ones."""
        for camera in self.cameras:
            if camera.id == camera_id:
                return camera
        raise RigError(f"found no camera {camera_id} in rig {self.name}", f"one of {', '.join(self.ids)}")

    def only(self, camera_ids: Iterable[str]) -> Rig:
        """Return the rig with just these cameras, in the order given."""
        return replace(self, cameras=tuple(self.camera(c) for c in camera_ids))

    def scaled(self, width: int, height: int) -> Rig:
        """Return the rig with every sensor at another size in pixels."""
        return replace(self, cameras=tuple(c.scaled(width, height) for c in self.cameras))


def object_distance_m(cameras: Sequence[Camera]) -> float:
    """Return how far the cameras are from the point nearest to all their optical axes: the mean along these, in metres.

    Parallel axes never meet; ten baselines then stand for the object's distance.
    """
    centers = np.stack([c.center for c in cameras])
    axes = np.stack([c.cam_from_rig.rotation[2] for c in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # [V, 3, 3], removes the part along each axis
    baseline = float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).mean())
    normal = across.sum(axis=0)
    distance = 10 * baseline
    if np.linalg.eigvalsh(normal)[0] > 1e-4 * len(cameras):
        meeting = np.linalg.solve(normal, np.einsum("vij,vj->i", across, centers))
        distance = float(np.einsum("vi,vi->v", meeting - centers, axes).mean())
    return max(distance, 2 * baseline, 1e-3)
