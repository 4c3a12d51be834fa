"""The one interface of all methods; nothing here loads torch, for the plan reads it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from reconstruction.initialization.points import Points

if TYPE_CHECKING:
    from reconstruction.initialization.bodies import Bodies
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
class Method:
    """`start` makes the model that is trained.

    `moves`: whether it knows motion; without, the whole clip is one still scene to it. `canonical`: the share of the
    clip at which alone movers are swept (None: at several instants). `supervision`: what it is published with, taken
    where the operator leaves it open. `watched`: whether still Gaussians that turn out to move are let go. `trainer`:
    fields of TrainerSettings that differ from the defaults. `gaussians`: how many, where the operator does not say.
    `rays`: whether it is a radiance field, which learns from spikes of single rays: no other supervision, and no
    refinement.
    """

    name: str
    start: Callable[[Seeds], SceneModel]
    moves: bool = True
    canonical: float | None = None
    supervision: str = "pixels"
    watched: bool = False
    rays: bool = False
    gaussians: int = 48_000
    trainer: Mapping[str, Any] = field(default_factory=dict)
