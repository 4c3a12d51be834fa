"""Closed-form motion of things that are joined: limbs on hinges, and a sheet of narrow strips."""

import math
from dataclasses import dataclass

import numpy as np

from acquisition.scenes.motion import Floats, Movement, Vector, turns
from rigs.transform import Transform


@dataclass(frozen=True, eq=False)
class Hinge(Movement):
    """A limb that swings about `axis` through a joint of its parent, by the angle rest + swing sin(rate t + phase).

    At the angle 0 it lies as `parent_from_joint` says.
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
        """True where the parent moves or the part swings."""
        return self.parent.moving or self.swing_rad * self.rate_rad_s != 0

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        joint = self.parent.world_from_body(instants_s).of(self.parent_from_joint)
        angles = self.rest_rad + self.swing_rad * np.sin(self.rate_rad_s * instants_s + self.phase_rad)
        return joint.rotations @ turns(self.axis, angles), joint.translations


@dataclass(frozen=True, eq=False)
class Sway(Movement):
    """A thing waved to and fro: it shifts and turns about its own origin by sines of its own rates.

    With s = sin(rate t + phase) of each component it is at start + reach s, turned by the rotation vector turn s.
    """

    start: Transform
    reach_m: Vector
    turn_rad: Vector
    rates_rad_s: Vector
    turn_rates_rad_s: Vector
    phases_rad: Vector = (0.0, 0.0, 0.0)

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        t, phases = instants_s[:, None], np.array(self.phases_rad)
        shifts = np.array(self.reach_m) * np.sin(np.array(self.rates_rad_s) * t + phases)
        rotvecs = np.array(self.turn_rad) * np.sin(np.array(self.turn_rates_rad_s) * t + phases)
        turned = [turns(r, [math.hypot(*r)])[0] if r.any() else np.eye(3) for r in rotvecs]
        return np.array(turned).reshape(-1, 3, 3) @ self.start.rotation, self.start.translation + shifts


@dataclass(frozen=True)
class Wave:
    """A wave that runs along a sheet of `strips` rigid strips, each `width_m` wide and hinged to the one before.

    Strip i leans out of the sheet's plane by swing sin(rate t - pace i); the first edge stays at `start`. The sheet
    keeps its length. This chain of facets itself is simulated, not a smooth surface that it would stand for.
    """

    start: Transform  # x along the sheet, y along the strips' hinges
    strips: int
    width_m: float
    swing_rad: float
    rate_rad_s: float
    pace_rad: float

    def angles(self, instants_s: Floats) -> Floats:
        """Return how far each strip leans at `instants_s` [n], in radians [n, strips]."""
        return self.swing_rad * np.sin(self.rate_rad_s * instants_s[:, None] - self.pace_rad * np.arange(self.strips))


@dataclass(frozen=True)
class Strip(Movement):
    """One strip of a waving sheet; its origin is its middle."""

    wave: Wave
    index: int

    def _poses(self, instants_s: Floats) -> tuple[Floats, Floats]:
        wave, angles = self.wave, self.wave.angles(instants_s)[:, : self.index + 1]
        steps = wave.width_m * np.stack([np.cos(angles), np.zeros_like(angles), -np.sin(angles)], axis=-1)
        middles = steps[:, : self.index].sum(axis=1) + steps[:, self.index] / 2
        leans = turns((0.0, 1.0, 0.0), angles[:, self.index])
        return wave.start.rotation @ leans, middles @ wave.start.rotation.T + wave.start.translation
