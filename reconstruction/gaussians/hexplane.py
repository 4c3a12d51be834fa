"""4DGS: one canonical cloud, deformed by a field on six planes of space and time and a small network.

Letters: M moving Gaussians, F features, S cells along x, y and z, T along time, W width of the network, H heads. Each
level has planes xy, xz, yz [3, F, S, S] and xt, yt, zt [3, F, T, S], whose six samples are multiplied; the features of
the levels are joined. Cost: M x (12 x F bilinear samples + about H W^2 multiplications) a render.
Source: Wu et al., "4D Gaussian splatting for real-time dynamic scene rendering", CVPR 2024, with the sizes and weights
that its code has for several views; Cao & Johnson, "HexPlane", CVPR 2023. Planes of space start uniform in 0.1 to 0.5,
planes of time at one. Planes of space have the total variation that the paper names, where its code has squared second
differences along one axis. Not as there: last layers that start at zero, so that the field begins without any
deformation, light that is deformed as one number in place of spherical harmonics, and lengths in units of the box.
Pictures are compared by L1 and SSIM, as for all methods here, where its code has L1 alone.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple, Self

import torch
from torch import Tensor
from torch.nn.functional import grid_sample, linear

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import Rate

FEATURES = 16
AXES = torch.tensor([[0, 1], [0, 2], [1, 2]])  # of planes xy, xz, yz
TIME_ONE = 1e-4  # weight of |1 - planes of time|
STRAY = 0.02  # share of points at each end of an axis that the box leaves out
OUTPUTS = (3, 4, 3, 1, 1)  # the fields of Offsets, in their order: a head each


class Offsets(NamedTuple):
    """The changes of M Gaussians; the last ones are None where a field has no heads for them.

    `shift` is in halves of the box, `opacity` of the logit, `light` in units of the field's brightness.
    """

    shift: Tensor  # [M, 3]
    turn: Tensor | None = None  # [M, 4]
    stretch: Tensor | None = None  # [M, 3] of log scales
    opacity: Tensor | None = None  # [M, 1]
    light: Tensor | None = None  # [M, 1]


class FieldShape(NamedTuple):
    """The sizes of a field, and the weights of squared steps between its cells in space and of second ones in time."""

    space_cells: tuple[int, int] = (64, 128)  # coarse and fine
    time_cells: int = 150
    width: int = 128
    heads: int = len(OUTPUTS)
    smooth_space: float = 2e-4
    smooth_time: float = 1e-3


def rates_of(planes: float, network: float) -> dict[str, Rate]:
    """Return the rates of every learnt tensor of a field."""
    return {
        **dict.fromkeys(("coarse_space", "coarse_time", "fine_space", "fine_time"), Rate(planes, deforms=True)),
        **dict.fromkeys(("trunk", "hidden", "heads"), Rate(network, deforms=True)),
    }


@dataclass
class HexPlaneMotion(MotionModel):
    """The weights of the field, and the `box` it covers, by its lowest and highest corner.

    Offsets of positions are in units of half the box, so that one learning rate fits scenes of any size. Beyond the box
    and the clip the field continues as at its edge.
    """

    kind = "4dgs"
    networks = True
    shape: ClassVar[FieldShape] = FieldShape()
    rates: ClassVar[Mapping[str, Rate]] = rates_of(planes=2e-2, network=1e-3)
    box: Tensor  # [2, 3] m
    coarse_space: Tensor  # [3, F, S, S] planes xy, xz, yz
    coarse_time: Tensor  # [3, F, T, S] planes xt, yt, zt
    fine_space: Tensor  # [3, F, 2 S, 2 S]
    fine_time: Tensor  # [3, F, T, 2 S]
    trunk: Tensor  # [W, 2 F + 1], the last column is the bias
    hidden: Tensor  # [H, W, W + 1], one a head
    heads: Tensor  # [sum of the first H OUTPUTS, W + 1]
    brightness: Tensor = field(default_factory=lambda: torch.ones(0))  # [1] spikes per tick; [0] without such a head

    @classmethod
    def over(cls, box: Tensor, generator: torch.Generator, brightness: float = 1.0) -> Self:
        """Return a field over `box` [2, 3] that deforms nothing yet."""
        shape, width = cls.shape, cls.shape.width
        spaces = [torch.empty(3, FEATURES, s, s).uniform_(0.1, 0.5, generator=generator) for s in shape.space_cells]
        times = [torch.ones(3, FEATURES, shape.time_cells, s) for s in shape.space_cells]
        return cls(
            box=box,
            coarse_space=spaces[0],
            coarse_time=times[0],
            fine_space=spaces[1],
            fine_time=times[1],
            trunk=layer((width, 2 * FEATURES), generator),
            hidden=torch.stack([layer((width, width), generator) for _ in range(shape.heads)]),
            heads=torch.zeros(sum(OUTPUTS[: shape.heads]), width + 1),
            brightness=torch.full((int(shape.heads == len(OUTPUTS)),), brightness),
        )

    def at(self, moving: GaussianCloud, u: float) -> Instantaneous:
        """Return every Gaussian changed by the field at its canonical mean and u."""
        low, high = self.box
        shift, turn, stretch, opacity, light = self.offsets(self.places(moving.means), min(max(u, 0.0), 1.0))
        logits = moving.opacity_logits if opacity is None else moving.opacity_logits + opacity[:, 0]
        return Instantaneous(
            moving.means + shift * (high - low) / 2,
            moving.quats_wxyz if turn is None else moving.quats_wxyz + turn,
            moving.log_scales if stretch is None else moving.log_scales + stretch,
            logits.sigmoid(),
            moving.intensities if light is None else moving.intensities + light * self.brightness,
        )

    def places(self, means: Tensor) -> Tensor:
        """Return `means` [M, 3] as places [M, 3] in the box, from -1 to 1."""
        low, high = self.box
        return ((means - low) / ((high - low) / 2) - 1).clamp(-1, 1)

    def offsets(self, places: Tensor, u: float) -> Offsets:
        """Return the offsets at `places` [M, 3] in -1 to 1 and u in 0 to 1."""
        across = places[:, AXES].transpose(0, 1)[:, None]  # [3, 1, M, 2]
        along = torch.stack([places.T, torch.full_like(places.T, 2 * u - 1)], dim=-1)[:, None]
        levels = ((self.coarse_space, self.coarse_time), (self.fine_space, self.fine_time))
        features = torch.cat([_fused(space, time, across, along) for space, time in levels])  # [2 F, M]
        trunk = affine(self.trunk, features.T).relu()
        rows = self.heads.split(OUTPUTS[: len(self.hidden)])
        return Offsets(*(affine(r, affine(h, trunk).relu()) for r, h in zip(rows, self.hidden, strict=True)))

    def penalty(self, moving: GaussianCloud) -> Tensor:
        """Return the regulariser of the planes, which reads nothing of `moving`."""
        return self.roughness()

    def roughness(self) -> Tensor:
        """Return the weighted sum of squared differences in space, second ones in time, and |1 - planes of time|."""
        spaces, times = (self.coarse_space, self.fine_space), (self.coarse_time, self.fine_time)
        space = torch.stack([2 * (_rough(p, 2, 1) + _rough(p, 3, 1)) for p in spaces]).sum()
        time = torch.stack([_rough(p, 2, 2) for p in times]).sum()
        away = torch.stack([len(p) * (1 - p).abs().mean() for p in times]).sum()
        return self.shape.smooth_space * space + self.shape.smooth_time * time + TIME_ONE * away


class SmallHexPlaneMotion(HexPlaneMotion):
    """A field of half the cells and width, a sixth of the times, and no change of opacity and light."""

    kind = "4dgs-small"
    shape = FieldShape((32, 64), 25, 64, 3, 1e-4, 1e-2)
    rates = rates_of(planes=2e-2, network=4e-3)


def box_around(means: Tensor, least_m: float) -> Tensor:
    """Return the corners [2, 3] of a cube over most of `means` [M, 3] with half as much again on every side, in m.

    Half the cube is at least `least_m`: points close to one another do not tell how far they may go.
    """
    low, high = means.quantile(STRAY, dim=0), means.quantile(1 - STRAY, dim=0)
    half = ((high - low) / 2).amax().clamp_min(least_m) * 1.5
    return torch.stack([(low + high) / 2 - half, (low + high) / 2 + half])


def layer(shape: tuple[int, int], generator: torch.Generator) -> Tensor:
    """Return Xavier's uniform weights [m, n + 1] for `shape` (m, n), with a last column of zeros for the bias."""
    reach = math.sqrt(6 / sum(shape))
    weights = torch.empty(shape).uniform_(-reach, reach, generator=generator)
    return torch.cat([weights, torch.zeros(shape[0], 1)], dim=1)


def affine(weights: Tensor, values: Tensor) -> Tensor:
    """Return `values` [M, n] after a layer `weights` [m, n + 1] whose last column is the bias, [M, m]."""
    return linear(values, weights[:, :-1], weights[:, -1])


def _fused(space: Tensor, time: Tensor, across: Tensor, along: Tensor) -> Tensor:
    """Return the product [F, M] of the six planes of a level, sampled at `across` and `along` [3, 1, M, 2]."""
    options = {"mode": "bilinear", "padding_mode": "border", "align_corners": True}
    sampled = [grid_sample(plane, where, **options) for plane, where in ((space, across), (time, along))]
    both = sampled[0] * sampled[1]
    return (both[0] * both[1] * both[2])[:, 0]


def _rough(planes: Tensor, dim: int, order: int) -> Tensor:
    """Return the sum over `planes` [3, F, m, n] of the mean squared differences along `dim`."""
    return len(planes) * planes.diff(n=order, dim=dim).square().mean()
