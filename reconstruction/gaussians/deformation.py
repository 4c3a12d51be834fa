"""Deformable 3D Gaussians: one canonical cloud, deformed by a network of place and time.

Letters: M moving Gaussians, W width of the network, D inner layers, I inputs. A place, -1 to 1 in the box, is encoded
by itself and the sines and cosines of pi times it, times 1, 2, 4 and so on; the time likewise. Cost: M x about D W^2
multiplications a render.
Source: Yang et al., "Deformable 3D Gaussians for high-fidelity monocular dynamic scene reconstruction", CVPR 2024. As
there: the encoding, the input given again half-way, offsets of position, quaternion and log scales, no gradient to the
means through the encoding. Not as there: width, depth and octaves, which are 256, 8, 10 and 6 or 10 there and too
costly on a CPU, and a last layer that starts at zero, so that the field begins without any deformation.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import torch
from torch import Tensor

from reconstruction.gaussians.canonical import OUTPUTS, CanonicalMotion, affine, box_around, layer
from reconstruction.scene_model import Rate

WIDTH = 64
INNER = 4
PLACE_OCTAVES, TIME_OCTAVES = 4, 6
INPUTS = 3 * (1 + 2 * PLACE_OCTAVES) + 1 + 2 * TIME_OCTAVES


@dataclass
class DeformationMotion(CanonicalMotion):
    """The network's weights."""

    kind = "deformation"
    networks = True
    rates: ClassVar[Mapping[str, Rate]] = dict.fromkeys(("entry", "inner", "again", "exit"), Rate(3e-3, deforms=True))
    entry: Tensor  # [W, I + 1], the last column is the bias
    inner: Tensor  # [D, W, W + 1]
    again: Tensor  # [W, I + 1], the input added half-way
    exit: Tensor  # [10, W + 1]: rows of position, quaternion, log scales

    @classmethod
    def around(cls, means: Tensor, least_m: float, generator: torch.Generator) -> Self:
        """Return a field that deforms nothing yet, over the box that `box_around` finds."""
        return cls(
            box=box_around(means, least_m),
            entry=layer((WIDTH, INPUTS), generator),
            inner=torch.stack([layer((WIDTH, WIDTH), generator) for _ in range(INNER)]),
            again=layer((WIDTH, INPUTS), generator),
            exit=torch.zeros(sum(OUTPUTS), WIDTH + 1),
        )

    def offsets(self, places: Tensor, u: float) -> tuple[Tensor, Tensor, Tensor]:
        """Return offsets [M, 3], [M, 4], [M, 3] at `places` [M, 3] in -1 to 1 and u in 0 to 1."""
        time = encoded(places.new_tensor([[2 * u - 1]]), TIME_OCTAVES).expand(len(places), -1)
        inputs = torch.cat([encoded(places.detach(), PLACE_OCTAVES), time], dim=1)
        values = affine(self.entry, inputs).relu()
        for i, weights in enumerate(self.inner):
            values = affine(weights, values)
            values = (values + affine(self.again, inputs) if i == len(self.inner) // 2 else values).relu()
        shift, turn, stretch = affine(self.exit, values).split(OUTPUTS, dim=1)
        return shift, turn, stretch


def encoded(values: Tensor, octaves: int) -> Tensor:
    """Return `values` [M, n] beside the sines and cosines of pi 2^k times them: [M, n (1 + 2 octaves)]."""
    angles = math.pi * torch.cat([values * 2**k for k in range(octaves)], dim=1)
    return torch.cat([values, angles.sin(), angles.cos()], dim=1)
