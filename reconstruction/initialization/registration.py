"""Two samples of one rigid surface to the transform between them, without knowing which point is which.

Letters: n points of the target, m of the model. Every target point is matched softly with all model points, by distance
and by brightness (`matching`); the rigid fit to the matches is closed form; the width of the matches follows the
residuals down to `floor`. Cost: n x m a round, so both are thinned to MOST_POINTS. Needs a guess within a few widths.
Source: Myronenko & Song, "Point set registration: coherent point drift", PAMI 2010.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.initialization.matching import rigid_fit, soft_matches
from reconstruction.initialization.nearest import nearest
from reconstruction.initialization.points import Points
from rigs.transform import Transform

MOST_POINTS = 400
ROUNDS = 20
STRAY = 0.2  # share of the target that is expected to have no partner
CROWDING = 0.1  # points lie on surfaces: most of the volume around them is empty
LEAST_MATCHED = 3.0


@dataclass(frozen=True, eq=False)
class Placed:
    """Points as tensors: positions [n, 3] in m and intensities [n] in spikes per tick, float32."""

    positions: Tensor
    intensities: Tensor

    @classmethod
    def of(cls, points: Points) -> Placed:
        """The same points."""
        return cls(
            torch.from_numpy(points.positions.astype(np.float32)),
            torch.from_numpy(points.intensities.astype(np.float32)),
        )

    @classmethod
    def joined(cls, parts: Sequence[Placed]) -> Placed:
        """All points of `parts`, in order."""
        return cls(torch.cat([p.positions for p in parts]), torch.cat([p.intensities for p in parts]))

    def __len__(self) -> int:
        return len(self.positions)

    def select(self, which: NDArray) -> Placed:
        """The points at indices or where a mask is true."""
        chosen = torch.from_numpy(which)
        return Placed(self.positions[chosen], self.intensities[chosen])

    def moved(self, pose: Transform) -> Placed:
        """The points carried by `pose`."""
        turn, shift = (np.asarray(a, np.float32) for a in (pose.rotation, pose.translation))
        return Placed(torch.from_numpy(self.positions.numpy() @ turn.T + shift), self.intensities)


def sampled(points: Placed) -> Placed:
    """Every so-manieth point, at most MOST_POINTS."""
    if len(points) <= MOST_POINTS:
        return points
    return points.select(np.linspace(0, len(points) - 1, MOST_POINTS).astype(np.int64))


def nearest_of(points: Placed, others: Placed) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """For each of n points the distance [n] in m to the nearest of the others, and which one that is."""
    apart, which = nearest(points.positions.numpy(), others.positions.numpy())
    return apart[:, 0], which[:, 0]


def register(model: Placed, target: Placed, guess: Transform, width: float, floor: float) -> Transform:
    """Target from model, begun at `guess` with matches `width` metres wide, which narrow to half of `floor`."""
    pose = guess
    volume = float((target.positions.amax(dim=0) - target.positions.amin(dim=0)).clamp_min(floor).prod())
    lever = float(model.positions.norm(dim=1).amax())
    model_cloud, target_cloud = ((p.positions.numpy(), p.intensities.numpy()) for p in (model, target))
    for _ in range(ROUNDS):
        stray = STRAY / (1 - STRAY) * len(model) * CROWDING * (2 * np.pi) ** 1.5 * width**3 / volume
        matches = soft_matches(model_cloud, target_cloud, pose, width, stray)
        if matches.total < LEAST_MATCHED:
            break
        found = rigid_fit(matches)
        still = _apart(found, pose, lever) < 1e-3 * floor
        pose = found
        residual = (matches.squared / (3 * matches.total)) ** 0.5
        narrowed = max(floor / 2, min(width * 0.8, residual))
        if still and narrowed == width:
            break
        width = narrowed
    return pose


def _apart(one: Transform, other: Transform, lever: float) -> float:
    """How far, in metres, a point at the end of the lever lies from where the other pose puts it, at most."""
    turn = float(np.linalg.norm(one.rotation - other.rotation))
    return float(np.linalg.norm(one.translation - other.translation)) + lever * turn
