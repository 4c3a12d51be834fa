"""4DGS: canonical Gaussians deformed by a HexPlane field; the model of Spike4DGS and of its baselines TFI + 4DGS.

Source: Wu et al., "4D Gaussian splatting for real-time dynamic scene rendering", CVPR 2024; `gaussians.hexplane` says
what of the field is as published. Ours: points from the sweep at the middle of the clip, still Gaussians beside the
field (published: all are deformed), a cap in place of densification, our rates and kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.methods.definition import Method, Seeds

if TYPE_CHECKING:
    from reconstruction.gaussians.dynamic import DynamicCloud


def _start(seeds: Seeds) -> DynamicCloud:
    from reconstruction.initialization.seeding import seed_field

    return seed_field(seeds.still, seeds.moving, seeds.clip, seeds.seed)


FOUR_DGS = Method("4dgs", _start, canonical=0.5, watched=True)
