"""4DGS: one canonical cloud, deformed by a field on six planes of space and time and a small network.

Letters: M moving Gaussians, F features, S cells along x, y and z, T along time, W width of the network. Each level has
planes xy, xz, yz [3, F, S, S] and xt, yt, zt [3, F, T, S], whose six samples are multiplied; the features of the levels
are joined. Cost: M x (12 x F bilinear samples + about 3 W^2 multiplications) a render.
Source: Wu et al., "4D Gaussian splatting for real-time dynamic scene rendering", CVPR 2024; Cao & Johnson, "HexPlane",
CVPR 2023. As there: two levels, planes of space that start uniform in 0.1 to 0.5 and of time that start at one. Not as
there: a smaller grid (32 and 64 cells, 25 times; published for several views: 64 and 128, 150) and network (64 wide;
published 128), opacity and colour not deformed, a weight of 0.01 on smoothness in time (published 0.001), and last
layers that start at zero, so that the field begins without any deformation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from reconstruction.gaussians.canonical import OUTPUTS, CanonicalMotion, affine, box_around, layer
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.scene_model import Rate

FEATURES = 16
WIDTH = 64
SPACE_CELLS = (32, 64)  # coarse and fine
TIME_CELLS = 25
AXES = torch.tensor([[0, 1], [0, 2], [1, 2]])  # of planes xy, xz, yz
SMOOTH_SPACE, SMOOTH_TIME, TIME_ONE = 1e-4, 1e-2, 1e-4  # weights of the regulariser


@dataclass
class HexPlaneMotion(CanonicalMotion):
    """The weights of the field."""

    kind = "4dgs"
    networks = True
    rates: ClassVar[Mapping[str, Rate]] = {
        **dict.fromkeys(("coarse_space", "coarse_time", "fine_space", "fine_time"), Rate(2e-2, deforms=True)),
        **dict.fromkeys(("trunk", "hidden", "heads"), Rate(4e-3, deforms=True)),
    }
    coarse_space: Tensor  # [3, F, S, S] planes xy, xz, yz
    coarse_time: Tensor  # [3, F, T, S] planes xt, yt, zt
    fine_space: Tensor  # [3, F, 2 S, 2 S]
    fine_time: Tensor  # [3, F, T, 2 S]
    trunk: Tensor  # [W, 2 F + 1], the last column is the bias
    hidden: Tensor  # [3, W, W + 1], one a head
    heads: Tensor  # [10, W + 1]: rows of position, quaternion, log scales

    @classmethod
    def around(cls, means: Tensor, least_m: float, generator: torch.Generator) -> Self:
        """Return a field that deforms nothing yet, over the box that `box_around` finds."""
        spaces = [torch.empty(3, FEATURES, s, s).uniform_(0.1, 0.5, generator=generator) for s in SPACE_CELLS]
        times = [torch.ones(3, FEATURES, TIME_CELLS, s) for s in SPACE_CELLS]
        return cls(
            box=box_around(means, least_m),
            coarse_space=spaces[0],
            coarse_time=times[0],
            fine_space=spaces[1],
            fine_time=times[1],
            trunk=layer((WIDTH, 2 * FEATURES), generator),
            hidden=torch.stack([layer((WIDTH, WIDTH), generator) for _ in OUTPUTS]),
            heads=torch.zeros(sum(OUTPUTS), WIDTH + 1),
        )

    def offsets(self, places: Tensor, u: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return offsets [M, 3], [M, 4], [M, 3] at `places` [M, 3] in -1 to 1 and u in 0 to 1."""
        across = places[:, AXES].transpose(0, 1)[:, None]  # [3, 1, M, 2]
        along = torch.stack([places.T, torch.full_like(places.T, 2 * u - 1)], dim=-1)[:, None]
        levels = ((self.coarse_space, self.coarse_time), (self.fine_space, self.fine_time))
        features = torch.cat([_fused(space, time, across, along) for space, time in levels])  # [2 F, M]
        trunk = affine(self.trunk, features.T).relu()
        rows = self.heads.split(OUTPUTS)
        shift, turn, stretch = (affine(r, affine(h, trunk).relu()) for r, h in zip(rows, self.hidden, strict=True))
        return shift, turn, stretch

    def penalty(self, moving: GaussianCloud) -> Tensor:
        """Return the weighted sum of squared differences in space, second ones in time, and |1 - planes of time|."""
        space = sum(_rough(p, 2, 1) + _rough(p, 3, 1) for p in (self.coarse_space, self.fine_space))
        times = (self.coarse_time, self.fine_time)
        time = sum(_rough(p, 2, 2) for p in times)
        away = sum((1 - p).abs().mean() for p in times)
        return SMOOTH_SPACE * space + SMOOTH_TIME * time + TIME_ONE * away  # type: ignore[return-value]


def _fused(space: Tensor, time: Tensor, across: Tensor, along: Tensor) -> Tensor:
    """Return the product [F, M] of the six planes of a level, sampled at `across` and `along` [3, 1, M, 2]."""
    options = {"mode": "bilinear", "padding_mode": "border", "align_corners": True}
    sampled = [grid_sample(plane, where, **options) for plane, where in ((space, across), (time, along))]
    both = sampled[0] * sampled[1]
    return (both[0] * both[1] * both[2])[:, 0]


def _rough(planes: Tensor, dim: int, order: int) -> Tensor:
    return planes.diff(n=order, dim=dim).square().mean()
