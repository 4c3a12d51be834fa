"""Spacetime Gaussians; the motion of the baseline TFI + STG.

Source: Li et al., "Spacetime Gaussian feature splatting for real-time dynamic view synthesis", CVPR 2024. As published:
cubic paths, quaternions linear in time, an opacity window with a centre and a width of its own, points from several
instants (there from structure from motion, here from sweeps).
Ours: still Gaussians beside them (published: all have a window); grey light in place of features and their network; a
cap in place of densification and of sampling along rays; our rates and kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.methods.definition import Method, Seeds

if TYPE_CHECKING:
    from reconstruction.gaussians.dynamic import DynamicCloud


def _start(seeds: Seeds) -> DynamicCloud:
    from reconstruction.initialization.seeding import seed_spacetime

    return seed_spacetime(seeds.still, seeds.moving, seeds.clip, seeds.instants)


STG = Method("stg", _start, watched=True)
