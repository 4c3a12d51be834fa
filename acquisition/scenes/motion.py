"""Closed-form motion: the pose of a body at any instant, past or future, without integrating anything."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.errors import AcquisitionError
from rigs.transform import Transform

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]
GRAVITY_M_S2: Vector = (0.0, 9.81, 0.0)  # +y is down


class BodyPoses(NamedTuple):
    """world_from_body at n instants: `rotations` [n, 3, 3] and `translations` [n, 3] in metres."""

    rotations: Floats
    translations: Floats

    def of(self, body_from_part: Transform) -> BodyPoses:
        """Return the poses of a part that is fixed to the body."""
        moved = self.rotations @ body_from_part.translation + self.translations
        return BodyPoses(self.rotations @ body_from_part.rotation, moved)


class Movement(ABC):
    """The pose of a rigid thing at any instant; a subclass states it in `_poses`."""

    @property
    def moving(self) -> bool:
        """True where the pose ever changes."""
        return True

    def world_from_body(self, instants_s: ArrayLike) -> BodyPoses:
        """Return the poses at `instants_s` [n]."""
        return BodyPoses(*self._poses(np.asarray(instants_s, dtype=np.float64)))

    @abstractmethod
    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]: ...


@dataclass(frozen=True, eq=False)
class Motion(Movement):
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
        """True where the body spins or flies."""
        return self.spin_rad_s != 0 or any(self.velocity_m_s) or any(self.acceleration_m_s2)

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        flight = instants_s - self.launch_s
        since = (flight if math.isinf(self.bounce_s) else flight % self.bounce_s)[:, None]
        velocity, acceleration = np.array(self.velocity_m_s), np.array(self.acceleration_m_s2)
        translations = self.start.translation + velocity * since + acceleration * since**2 / 2
        return turns(self.spin_axis, self.spin_rad_s * instants_s) @ self.start.rotation, translations


def turns(axis: ArrayLike, angles_rad: ArrayLike) -> Floats:
    """Return the turns [n, 3, 3] by `angles_rad` [n] about `axis` [3], by Rodrigues' formula."""
    axis = np.asarray(axis)
    x, y, z = axis / math.hypot(*axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    square = cross @ cross
    turned = [np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * square for angle in np.asarray(angles_rad)]
    return np.array(turned).reshape(-1, 3, 3)
