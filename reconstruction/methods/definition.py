"""The one interface of all methods; nothing here loads torch, for the plan reads it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from reconstruction.initialization.bodies import Bodies
    from reconstruction.initialization.points import Points
    from reconstruction.scene_model import SceneModel, TimeSpan
    from rigs.camera import Camera


@dataclass(frozen=True)
class Seeds:
    """What every method starts from: points of the still scene, and of movers swept at `instants` moments of `clip`.

    `cameras` train. `bodies` reads what the moving points ride on. `seed`: of all draws.
    """

    still: Points
    moving: Points
    clip: TimeSpan
    instants: int
    seed: int
    cameras: Sequence[Camera]
    bodies: Callable[[], Bodies]


@dataclass(frozen=True)
class SpikeSampling:
    """The spikes that a term on spikes looks at.

    `every`: steps from one with the term to the next. `planes`: the shortest and the longest window. `size_px`: width
    and height of the part of a view (None: all of it).
    """

    every: int = 2
    planes: tuple[int, int] = (8, 33)
    size_px: tuple[int, int] | None = (160, 128)


@dataclass(frozen=True)
class Training:
    """The way a method is trained.

    `ends_early`: whether a training that no longer gains may end before its budget. `holds_depth`: weight of the loss
    on depths that the points stage confirmed; 0 is none. `deblurs`: whether a render is the mean of several instants
    where movers get far. `canonical_until`: share of the training before a field begins to deform (3,000 of 17,000
    steps in 4DGS). `spikes`: what a term on spikes looks at.
    """

    ends_early: bool = True
    holds_depth: float = 0.0
    deblurs: bool = False
    canonical_until: float = 3 / 17
    spikes: SpikeSampling = field(default_factory=SpikeSampling)


@dataclass(frozen=True)
class Method:
    """`start` makes the model that is trained.

    `moves`: whether it knows motion; without, the whole clip is one still scene to it. `canonical`: the share of the
    clip at which alone movers are swept (None: at several instants). `supervision`: what it is published with, taken
    where the operator leaves it open. `watched`: whether still Gaussians that turn out to move are let go.
    `gaussians`: how many, where the operator does not say. `rays`: whether it is a radiance field, which learns from
    spikes of single rays: no other supervision, and no refinement.
    """

    name: str
    start: Callable[[Seeds], SceneModel]
    moves: bool = True
    canonical: float | None = None
    supervision: str = "pixels"
    watched: bool = False
    rays: bool = False
    gaussians: int = 48_000
    training: Training = field(default_factory=Training)
