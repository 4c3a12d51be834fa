"""The definition of a method; it needs no torch, since the plan reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from reconstruction.initialization.points import Seeds
    from reconstruction.scene_model import SceneModel


@dataclass(frozen=True)
class SpikeSampling:
    """The spikes that a term on spikes looks at.

    `every`: steps from one with the term to the next. `planes`: the shortest and the longest window. `size_px`: width
    and height of the part of a view (None: all of it).
    """

    every: int = 2
    planes: tuple[int, int] = (8, 33)
    size_px: tuple[int, int] | None = (160, 128)


class RateFactors(NamedTuple):
    """The factors of the learning rates of still elements, of moving ones, and of their motion."""

    still: float = 1.0
    moving: float = 1.0
    motion: float = 1.0

    def times(self, other: RateFactors) -> RateFactors:
        """Return the factors of both together."""
        return RateFactors(*(a * b for a, b in zip(self, other, strict=True)))


AS_KIND = RateFactors()
SWEEPS = 8  # usual instants at which movers are swept


@dataclass(frozen=True)
class Training:
    """The way a method is trained.

    `ends_early`: whether a training that no longer gains may end before its budget. `enough_steps`: steps at which it
    ends then in any case (None: as many as the budget has room for). `holds_depth`: weight of the loss on depths that
    the points stage confirmed; 0 is none. `deblurs`: whether a render is the mean of several instants where movers get
    far. `canonical_until`: share of the training before a field begins to deform (3,000 of 17,000 steps in 4DGS).
    `rates`: the factors of its learning rates. `spikes`: what a term on spikes looks at.
    """

    ends_early: bool = True
    enough_steps: int | None = None
    holds_depth: float = 0.0
    deblurs: bool = False
    canonical_until: float = 3 / 17
    rates: RateFactors = AS_KIND
    spikes: SpikeSampling = field(default_factory=SpikeSampling)


@dataclass(frozen=True)
class Method:
    """A way to reconstruct a scene; `start` makes the model that is trained.

    `moves`: whether it knows motion; without, it takes the whole clip for one still scene. `canonical`: the share of
    the clip at which movers are swept (None: at several instants, `sweeps` of them in a recording of one piece).
    `supervision`: the one it is published with, used where the operator leaves it open. `watched`: whether still
    Gaussians that turn out to move are let go. `rays`: whether it is a radiance field, which learns from spikes of
    single rays, by no other supervision and without refinement. `ours`: whether it is a method of this project; the
    others are baselines. `gaussians`: the number of them where the operator gives none. `training`: how it is trained.
    """

    name: str
    start: Callable[[Seeds], SceneModel]
    moves: bool = True
    canonical: float | None = None
    sweeps: int = SWEEPS
    supervision: str = "pixels"
    watched: bool = False
    rays: bool = False
    ours: bool = False
    gaussians: int = 48_000
    training: Training = field(default_factory=Training)


def seeded(name: str, **options: object) -> Callable[[Seeds], SceneModel]:
    """Return a start by the function `name` of `initialization.seeding`, which is imported when it is called."""

    def start(seeds: Seeds) -> SceneModel:
        from reconstruction.initialization import seeding

        return getattr(seeding, name)(seeds, **options)

    return start
