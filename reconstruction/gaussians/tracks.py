"""Follows rigid bodies through the spans of a scene: which body of a span is which of the span before.

Each span has found its bodies by itself. Both sides know the poses at a seam, so the same body fills the same space
there. Letters: K bodies of a span, A Gaussians that ride on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.quaternions import product, rotated
from reconstruction.scene_model import TimeSpan

CELL = 0.012  # side of the cells in which bodies are compared, over their distance from the cameras
SHARED = 0.25  # least share of the cells of either body that the other one fills, too
LEAST_RIDERS = 16  # Gaussians of a body that can be told from others
THERE = 0.05  # opacity of a Gaussian that is there
_SIDE = 1 << 20  # cells from the origin that a number has room for
Cells = NDArray[np.int64]


@dataclass(frozen=True)
class Leg:
    """One body in one span: `body` of `motion`, over `span`; its clip may reach further.

    The track's own frame is at `turn` [1, 4] and `shift` [1, 3] m in that of the body.
    """

    number: int
    span: TimeSpan
    clip: TimeSpan
    motion: RigidMotion
    body: int
    turn: Tensor
    shift: Tensor

    def pose(self, instant_s: float) -> tuple[Tensor, Tensor]:
        """Return the unit quaternion [1, 4] and the place [1, 3] in m of the track at an instant of the rig clock."""
        quat, center = (p[self.body : self.body + 1] for p in self.motion.poses(self.clip.fraction(instant_s)))
        return product(quat, self.turn), rotated(quat, self.shift) + center


@dataclass(frozen=True)
class Track:
    """A rigid body through neighbouring spans, in order of time; its frame stands in its middle where it begins."""

    number: int
    legs: tuple[Leg, ...]

    def at(self, instant_s: float) -> Leg | None:
        """Return the leg that an instant of the rig clock lies in; None where the body is not known then."""
        found = [leg for leg in self.legs if leg.span.first_s <= instant_s < leg.span.last_s]
        return found[0] if found else None


@torch.no_grad()
def tracks_of(scene: SpannedScene | DynamicCloud, distance_m: float) -> list[Track]:
    """Return the bodies of a scene, some `distance_m` from its cameras, through all its spans; by their beginning."""
    spans = [(s.clip, s.cloud) for s in scene.spans] if isinstance(scene, SpannedScene) else [(scene.clip, scene)]
    ended: list[list[Leg]] = []
    before: dict[int, list[Leg]] = {}
    cloud_before = None
    for number, (span, cloud) in enumerate(spans):
        now: dict[int, list[Leg]] = {}
        bodies = riders_of(cloud)
        pairs = same_bodies(cloud_before, cloud, span.first_s, CELL * distance_m) if before and bodies else {}
        for body, riders in bodies.items():
            assert cloud is not None
            assert isinstance(cloud.motion, RigidMotion)
            legs = before.pop(pairs[body], []) if body in pairs else []
            frame = _carried_on(legs[-1], cloud, body, span.first_s) if legs else _own_frame(cloud, riders)
            now[body] = [*legs, Leg(number, span, cloud.clip, cloud.motion, body, *frame)]
        ended += before.values()
        before, cloud_before = now, cloud
    found = sorted([*ended, *before.values()], key=lambda legs: (legs[0].number, legs[0].body))
    return [Track(i, tuple(legs)) for i, legs in enumerate(found)]


def riders_of(cloud: DynamicCloud | None) -> dict[int, Tensor]:
    """Return the numbers [n] of the Gaussians that ride on each body with enough of them; none of another model."""
    if cloud is None or not isinstance(cloud.motion, RigidMotion):
        return {}
    found = {body: torch.nonzero(cloud.motion.bodies == body)[:, 0] for body in range(len(cloud.motion.knot_quats))}
    return {body: riders for body, riders in found.items() if len(riders) >= LEAST_RIDERS}


def same_bodies(
    before: DynamicCloud | None, after: DynamicCloud | None, instant_s: float, cell_m: float
) -> dict[int, int]:
    """Return for bodies of the clouds `after` which one `before` fills the same cells at an instant; the surest first.

    No body is matched twice.
    """
    sides = [cells_of(cloud, instant_s, cell_m) for cloud in (before, after)]
    grown = [{body: _grown(cells) for body, cells in side.items()} for side in sides]
    shares = {
        (a, b): min(float(np.isin(sides[0][a], grown[1][b]).mean()), float(np.isin(sides[1][b], grown[0][a]).mean()))
        for a in sides[0]
        for b in sides[1]
    }
    pairs: dict[int, int] = {}
    for (a, b), share in sorted(shares.items(), key=lambda item: -item[1]):
        if share >= SHARED and b not in pairs and a not in pairs.values():
            pairs[b] = a
    return pairs


def cells_of(cloud: DynamicCloud | None, instant_s: float, cell_m: float) -> dict[int, Cells]:
    """Return the cells, as numbers, that each body fills at an instant; bodies that are not there have none."""
    riders = riders_of(cloud)
    if cloud is None or not riders:
        return {}
    means, opacities = cloud.movers(instant_s)
    places, there = (means / cell_m).floor().clamp(-_SIDE, _SIDE - 1).long().numpy(), (opacities > THERE).numpy()
    found = {body: np.unique(_numbered(places[own][there[own]])) for body, own in _plain(riders).items()}
    return {body: cells for body, cells in found.items() if len(cells)}


def _plain(riders: dict[int, Tensor]) -> dict[int, NDArray[np.int64]]:
    return {body: own.numpy() for body, own in riders.items()}


def _numbered(places: NDArray[np.int64]) -> Cells:
    """Return one number [n] for each cell [n, 3]."""
    x, y, z = (places + _SIDE).T
    return (x << 42) | (y << 21) | z


def _grown(cells: Cells) -> Cells:
    """Return cells and their neighbours."""
    steps: Sequence[int] = (-1, 0, 1)
    offsets = [(x << 42) + (y << 21) + z for x in steps for y in steps for z in steps]
    return np.unique(cells[:, None] + np.array(offsets))


def _own_frame(cloud: DynamicCloud, riders: Tensor) -> tuple[Tensor, Tensor]:
    """Return the frame of a track that begins: turned as its body, in the middle of its riders."""
    weights = cloud.moving.opacity_logits[riders].sigmoid()[:, None]
    middle = (weights * cloud.moving.means[riders]).sum(dim=0, keepdim=True) / weights.sum().clamp_min(1e-9)
    return torch.tensor([[1.0, 0.0, 0.0, 0.0]]), middle


def _carried_on(leg: Leg, cloud: DynamicCloud, body: int, seam_s: float) -> tuple[Tensor, Tensor]:
    """Return the frame of a track in another body, so that it goes on at a seam without a step."""
    assert isinstance(cloud.motion, RigidMotion)
    turned, place = leg.pose(seam_s)
    quat, center = (p[body : body + 1] for p in cloud.motion.poses(cloud.clip.fraction(seam_s)))
    back = quat * quat.new_tensor([1.0, -1.0, -1.0, -1.0])
    return product(back, turned), rotated(back, place - center)
