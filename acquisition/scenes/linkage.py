"""Closed-form motion of things that are joined: limbs on hinges, and a sheet of narrow strips."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.motion import Movement, Poses, Vector, rotation
from rigs.transform import Transform


@dataclass(frozen=True, eq=False)
class Hinge:
    """A limb that swings about `axis` through a joint of its parent.

    Its angle is rest + swing sin(rate t + phase), or rest + rate t where it `spins`; at rest 0 it lies as
    `parent_from_joint` says.
    """

    parent: Movement
    parent_from_joint: Transform
    axis: Vector = (0.0, 0.0, 1.0)
    rest_rad: float = 0.0
    swing_rad: float = 0.0
    rate_rad_s: float = 0.0
    phase_rad: float = 0.0

    @property
    def moving(self) -> bool:
        """Whether the pose ever changes."""
        return self.parent.moving or self.swing_rad * self.rate_rad_s != 0

    def world_from_body(self, instants_s: NDArray[np.float64]) -> Poses:
        """Rotations [n, 3, 3] and translations [n, 3] in metres at `instants_s` [n]."""
        turned, moved = self.parent.world_from_body(instants_s)
        angles = self.rest_rad + self.swing_rad * np.sin(self.rate_rad_s * np.asarray(instants_s) + self.phase_rad)
        swung = np.array([rotation(self.axis, angle) for angle in angles]).reshape(-1, 3, 3)
        joint = self.parent_from_joint
        return turned @ joint.rotation @ swung, turned @ joint.translation + moved


@dataclass(frozen=True, eq=False)
class Sway:
    """A thing waved to and fro: it shifts and turns about its own origin by sines of its own rates.

    With s = sin(rate t + phase) of each component it is at start + reach s, turned by the rotation vector turn s.
    """

    start: Transform
    reach_m: Vector
    turn_rad: Vector
    rates_rad_s: Vector
    turn_rates_rad_s: Vector
    phases_rad: Vector = (0.0, 0.0, 0.0)

    @property
    def moving(self) -> bool:
        """Whether the pose ever changes."""
        return any(self.reach_m) or any(self.turn_rad)

    def world_from_body(self, instants_s: NDArray[np.float64]) -> Poses:
        """Rotations [n, 3, 3] and translations [n, 3] in metres at `instants_s` [n]."""
        t, phases = np.asarray(instants_s, dtype=np.float64)[:, None], np.array(self.phases_rad)
        shifts = np.array(self.reach_m) * np.sin(np.array(self.rates_rad_s) * t + phases)
        turns = np.array(self.turn_rad) * np.sin(np.array(self.turn_rates_rad_s) * t + phases)
        rotations = [rotation((x, y, z), math.hypot(x, y, z)) if x or y or z else np.eye(3) for x, y, z in turns]
        return np.array(rotations).reshape(-1, 3, 3) @ self.start.rotation, self.start.translation + shifts


@dataclass(frozen=True)
class Wave:
    """A wave that runs along a sheet of `strips` rigid strips, each `width_m` wide and hinged to the one before.

    Strip i leans out of the sheet's plane by swing sin(rate t - pace i); the first edge stays at `start`. The sheet
    keeps its length: what is simulated is this chain of facets itself, not a smooth surface that it stands for.
    """

    start: Transform  # x along the sheet, y along the strips' hinges
    strips: int
    width_m: float
    swing_rad: float
    rate_rad_s: float
    pace_rad: float

    def angles(self, instants_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far each strip leans, in radians [n, strips]."""
        turns = self.rate_rad_s * np.asarray(instants_s, dtype=np.float64)[:, None]
        return self.swing_rad * np.sin(turns - self.pace_rad * np.arange(self.strips))


@dataclass(frozen=True)
class Strip:
    """One strip of a waving sheet; its origin is its middle."""

    wave: Wave
    index: int

    @property
    def moving(self) -> bool:
        """Whether the pose ever changes."""
        return self.wave.swing_rad * self.wave.rate_rad_s != 0

    def world_from_body(self, instants_s: NDArray[np.float64]) -> Poses:
        """Rotations [n, 3, 3] and translations [n, 3] in metres at `instants_s` [n]."""
        wave, angles = self.wave, self.wave.angles(instants_s)[:, : self.index + 1]
        steps = wave.width_m * np.stack([np.cos(angles), np.zeros_like(angles), -np.sin(angles)], axis=-1)
        middles = steps[:, : self.index].sum(axis=1) + steps[:, self.index] / 2
        leans = np.array([rotation((0.0, 1.0, 0.0), angle) for angle in angles[:, self.index]]).reshape(-1, 3, 3)
        return wave.start.rotation @ leans, middles @ wave.start.rotation.T + wave.start.translation
