"""Closed-form motion: the pose of a body at any instant, past or future, without integrating anything."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import AcquisitionError
from rigs.transform import Transform

Vector = tuple[float, float, float]
Poses = tuple[NDArray[np.float64], NDArray[np.float64]]  # rotations [n, 3, 3], translations [n, 3] in metres
GRAVITY_M_S2: Vector = (0.0, 9.81, 0.0)  # +y is down


class Movement(Protocol):
    """The pose of a rigid thing at any instant."""

    @property
    def moving(self) -> bool:
        """Whether the pose ever changes."""
        ...

    def world_from_body(self, instants_s: NDArray[np.float64]) -> Poses:
        """Rotations [n, 3, 3] and translations [n, 3] in metres at `instants_s` [n]."""
        ...


@dataclass(frozen=True, eq=False)
class Motion:
    """Constant spin about a world axis through the body's origin, and free flight of that origin.

    With v = `velocity_m_s`, a = `acceleration_m_s2` the origin is at start + v s + a s^2 / 2, where s is the time since
    the last bounce: (instant - `launch_s`) modulo `bounce_s`, or just their difference when it never bounces.
    Raises AcquisitionError for a spin axis of no length or a bounce that takes no time.
    """

    start: Transform  # world_from_body at the launch, not spun
    spin_axis: Vector = (0.0, 0.0, 1.0)
    spin_rad_s: float = 0.0
    velocity_m_s: Vector = (0.0, 0.0, 0.0)
    acceleration_m_s2: Vector = (0.0, 0.0, 0.0)
    launch_s: float = 0.0
    bounce_s: float = math.inf

    def __post_init__(self) -> None:
        if not math.hypot(*self.spin_axis) > 0:
            raise AcquisitionError(f"found the spin axis {self.spin_axis}", "one with a direction")
        if not self.bounce_s > 0:
            raise AcquisitionError(f"found a bounce of {self.bounce_s} s", "a positive time")

    @property
    def moving(self) -> bool:
        """Whether the pose ever changes."""
        return self.spin_rad_s != 0 or any(self.velocity_m_s) or any(self.acceleration_m_s2)

    def world_from_body(self, instants_s: NDArray[np.float64]) -> Poses:
        """Rotations [n, 3, 3] and translations [n, 3] in metres at `instants_s` [n]."""
        flight = np.asarray(instants_s, dtype=np.float64) - self.launch_s
        since = (flight if math.isinf(self.bounce_s) else flight % self.bounce_s)[:, None]
        velocity, acceleration = np.array(self.velocity_m_s), np.array(self.acceleration_m_s2)
        translations = self.start.translation + velocity * since + acceleration * since**2 / 2
        spins = [rotation(self.spin_axis, self.spin_rad_s * t) for t in np.asarray(instants_s)]
        return np.array(spins).reshape(-1, 3, 3) @ self.start.rotation, translations


def rotation(axis: Vector, angle_rad: float) -> NDArray[np.float64]:
    """The turn by `angle_rad` about `axis` [3, 3], by Rodrigues' formula."""
    x, y, z = np.array(axis) / math.hypot(*axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * (cross @ cross)
