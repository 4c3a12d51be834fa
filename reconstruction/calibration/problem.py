"""The parts of a bundle adjustment: observations of blocks by cameras, the values that may change, the loss.

Blocks are whatever the cameras look at, of any size: a point of the scene has 3 unknowns, the pose of a board 6.
Letters: C cameras, G free camera values, L blocks of D unknowns, O observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.projection import PARAMETERS, Cameras
from rigs.transform import Floats, cross_matrices, rotations

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ScenePoints:
    """Points [L, 3] in m that stand still."""

    positions: Floats

    def __len__(self) -> int:
        return len(self.positions)

    def place(self, which: Indices) -> tuple[Floats, Floats]:
        """Return each observation's point [O, 3] in m and its derivatives [O, 3, 3]; `which` [O] is its block."""
        return self.positions[which], np.broadcast_to(np.eye(3), (len(which), 3, 3))

    def moved(self, steps: Floats) -> ScenePoints:
        """Return the points after steps [L, 3]."""
        return ScenePoints(self.positions + steps)


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """A board at L instants: rotations [L, 3, 3] and translations [L, 3], rig from board.

    `corners` [O, 3] are the board's corners in m that the observations are of, in their order.
    """

    rotations: Floats
    translations: Floats
    corners: Floats

    def __len__(self) -> int:
        return len(self.translations)

    def place(self, which: Indices) -> tuple[Floats, Floats]:
        """Return each observation's point [O, 3] in m and its derivatives [O, 3, 6]; `which` [O] is its block."""
        turned = (self.rotations[which] @ self.corners[:, :, None])[:, :, 0]
        shift = np.broadcast_to(np.eye(3), (len(which), 3, 3))
        return turned + self.translations[which], np.concatenate([-cross_matrices(turned), shift], axis=2)

    def moved(self, steps: Floats) -> BoardPoses:
        """Return the poses after steps [L, 6], turns first."""
        turned = rotations(steps[:, :3]) @ self.rotations
        return replace(self, rotations=turned, translations=self.translations + steps[:, 3:])


Blocks = ScenePoints | BoardPoses


@dataclass(frozen=True, eq=False)
class Observations:
    """Pixels [O, 2], each of block `block` [O] seen by camera `camera` [O], with the standard deviation `sd_px` [O].

    `normals` [O, 2] are unit directions of those that were measured along one alone, NaN for the others; None: for all.
    """

    camera: Indices
    block: Indices
    pixels: Floats
    sd_px: Floats
    normals: Floats | None = None

    def __len__(self) -> int:
        return len(self.camera)

    def measured(self, vectors: Floats) -> Floats:
        """Return vectors [O, 2, n] in px in the directions that were measured."""
        if self.normals is None:
            return vectors
        along = self.normals[:, :, None]
        return np.where(np.isfinite(along), along * (along * vectors).sum(axis=1, keepdims=True), vectors)

    @classmethod
    def joined(cls, parts: Sequence[Observations]) -> Observations:
        """Return the observations of all parts, one after another."""
        normals = [np.full((len(p), 2), np.nan) if p.normals is None else p.normals for p in parts]
        return cls(
            np.concatenate([part.camera for part in parts]),
            np.concatenate([part.block for part in parts]),
            np.concatenate([part.pixels for part in parts]),
            np.concatenate([part.sd_px for part in parts]),
            np.concatenate(normals),
        )


@dataclass(frozen=True)
class Loss:
    """The loss of residuals: squares, Huber's or Cauchy's, whose bend is at `scale` standard deviations."""

    kind: Literal["squares", "huber", "cauchy"] = "squares"
    scale: float = 1.0

    def cost(self, squared: Floats) -> Floats:
        """Return the cost of squared residuals [O]."""
        s = squared / self.scale**2
        if self.kind == "huber":
            s = np.where(s > 1, 2 * np.sqrt(np.maximum(s, 1)) - 1, s)
        elif self.kind == "cauchy":
            s = np.log1p(s)
        return self.scale**2 * s

    def weight(self, squared: Floats) -> Floats:
        """Return the derivative of the cost by the squared residuals [O]."""
        s = squared / self.scale**2
        if self.kind == "huber":
            return 1 / np.sqrt(np.maximum(s, 1))
        return 1 / (1 + s) if self.kind == "cauchy" else np.ones_like(s)


@dataclass(frozen=True, eq=False)
class Freedom:
    """The camera parameters that may change: steps [C, 15] of PARAMETERS are `mixing` [C, 15, G] times G free values.

    `prior_sd` [G] is how far each value may be from zero (infinity: anywhere), `groups` [G] what it is a part of.
    """

    mixing: Floats
    prior_sd: Floats
    groups: tuple[str, ...] = ()

    @classmethod
    def none(cls, cameras: int) -> Freedom:
        """Return a freedom in which nothing may change."""
        return cls(np.zeros((cameras, len(PARAMETERS), 0)), np.zeros(0))

    @classmethod
    def poses(cls, cameras: int, center_sd_m: float, turn_sd: float = np.inf) -> Freedom:
        """Return a freedom of the poses, in the group "poses", with priors on the centres and on the turns in rad."""
        freedom = cls.none(cameras).each(PARAMETERS[:3], turn_sd, "poses")
        return freedom.each(PARAMETERS[3:6], center_sd_m, "poses")

    def freed(self, columns: Floats, prior_sd: float, group: str) -> Freedom:
        """Add a group of values that mix steps by `columns` [C, 15, n], all with the same prior around zero."""
        sds = np.append(self.prior_sd, np.full(columns.shape[2], prior_sd))
        return Freedom(np.concatenate([self.mixing, columns], axis=2), sds, self.groups + (group,) * columns.shape[2])

    def each(self, names: Sequence[str], prior_sd: float, group: str) -> Freedom:
        """Free the parameters `names` of every camera by itself."""
        freedom = self
        for name in names:
            columns = np.zeros((len(self.mixing), len(PARAMETERS), len(self.mixing)))
            columns[:, PARAMETERS.index(name)] = np.eye(len(self.mixing))
            freedom = freedom.freed(columns, prior_sd, group)
        return freedom

    def shared(self, name: str, prior_sd: float) -> Freedom:
        """Free one change of the parameter `name`, alike for all cameras, in a group of its name."""
        columns = np.zeros((len(self.mixing), len(PARAMETERS), 1))
        columns[:, PARAMETERS.index(name)] = 1.0
        return self.freed(columns, prior_sd, name)

    def shared_focal(self, cameras: Cameras, prior_sd: float) -> Freedom:
        """Free one factor of all focal lengths, as a relative change, in the group "focal"."""
        return self.freed(_own_focal(cameras).sum(axis=2, keepdims=True), prior_sd, "focal")

    def own_focal(self, cameras: Cameras, prior_sd: float, group: str) -> Freedom:
        """Free a factor of each camera's focal lengths, as a relative change."""
        return self.freed(_own_focal(cameras), prior_sd, group)

    def of(self, *groups: str) -> Indices:
        """Return where the values of these groups are."""
        return np.flatnonzero(np.isin(self.groups, groups))

    def only(self, kept: Indices) -> Freedom:
        """Return the freedom with the values at these places alone."""
        return Freedom(self.mixing[:, :, kept], self.prior_sd[kept], tuple(self.groups[i] for i in kept))


def _own_focal(cameras: Cameras) -> Floats:
    """Return the steps [C, 15, C] by which both focal lengths of one camera grow by their own size."""
    every = np.arange(len(cameras))
    columns = np.zeros((len(cameras), len(PARAMETERS), len(cameras)))
    for number, name in enumerate(("fx", "fy")):
        columns[every, PARAMETERS.index(name), every] = cameras.lenses[:, number]
    return columns


@dataclass(frozen=True, eq=False)
class State:
    """Cameras, what they see, and the sum of all steps [G] so far, which priors hold on to."""

    cameras: Cameras
    blocks: Blocks
    steps: Floats


@dataclass(frozen=True)
class Problem:
    """The observations, the values that may change, and the loss."""

    observations: Observations
    freedom: Freedom
    loss: Loss
