"""SpikeNeRF and Dy-SpikeNeRF: baselines that march rays through a radiance field in place of drawing Gaussians.

Source: Zhu et al., "SpikeNeRF: learning neural radiance fields from continuous spike stream", CVPR 2024. As published:
a radiance field, volume rendering, and a loss on long-term spikes through a neuron whose threshold varies from pixel to
pixel. Dy-SpikeNeRF is named by the authors of Spike4DGS and described as the static method with the deformation network
of 4DGS.
Ours: cells in place of a network (`radiance_fields.radiance_field`); the deformation network at knots of space, linear
between them; the neuron in expectation (`training.ray_term`); the points of the sweep to start from; no dependence on
the viewing direction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from reconstruction.methods.definition import Method, RateFactors, Training

if TYPE_CHECKING:
    from reconstruction.initialization.points import Seeds
    from reconstruction.radiance_fields.radiance_field import RadianceField


def _start(seeds: Seeds) -> RadianceField:
    from reconstruction.radiance_fields.cells import seed_cells

    still, moving = ((points.positions, points.intensities) for points in (seeds.still, seeds.moving))
    return seed_cells(still, moving, seeds.clip, seeds.cameras, seeds.seed)


SPIKENERF = Method("spikenerf", _start, moves=False, supervision="rays", rays=True)
SEARCHED = RateFactors(still=2.253, moving=1.565, motion=2.166)  # of Dy-SpikeNeRF, the best of twelve trials (171)
TRAINING = Training(rates=SEARCHED)
DY_SPIKENERF = Method("dy-spikenerf", _start, canonical=0.5, supervision="rays", rays=True, training=TRAINING)
