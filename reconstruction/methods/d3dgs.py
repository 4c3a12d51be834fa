"""Dynamic 3D Gaussians, timestep by timestep; the motion of the baseline TFI + D3DGS.

Source: Luiten et al., "Dynamic 3D Gaussians: tracking by persistent dynamic view synthesis", 3DV 2024. As published:
the first timestep learns everything and later ones only places and rotations, from the last plus their change, under
local rigidity, local rotation and isometry. Ours: Gaussians of the still scene beside, learnt all along (published:
one cloud, whose background is held by a mask); several instants between two timesteps, linearly interpolated
(published: one image a timestep); movers from the sweep at the first instant; a cap in place of densification, our
rates and kernels. What enters later has no Gaussians of its own, as published.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.methods.definition import Method, Seeds, Training

if TYPE_CHECKING:
    from reconstruction.gaussians.dynamic import DynamicCloud


def _start(seeds: Seeds) -> DynamicCloud:
    from reconstruction.initialization.seeding import seed_timesteps

    return seed_timesteps(seeds.still, seeds.moving, seeds.clip)


D3DGS = Method("d3dgs", _start, canonical=0.0, training=Training(ends_early=False))
