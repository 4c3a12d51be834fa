"""SpikeGS and Dy-SpikeGS: Gaussians that learn from spikes alone, of a still scene and of a deformed one.

Source: Yu et al., "SpikeGS: Learning 3D Gaussian fields from continuous spike stream", ACCV 2024 (two other papers
have that name); Spike4DGS names both as baselines. As published: no image is made of the spikes; what is rendered goes
through a model of the integrate-and-fire pixel and is compared with the recorded spikes; SpikeGS takes the scene for
still, Dy-SpikeGS deforms it.
Not published: the weights and rates of either, and how noise is embedded. Dy-SpikeGS is described as the static method
with the deformation network of 4DGS, and so it is here (`gaussians.hexplane`).
Ours: the expected count of a pixel whose phase is random over a window (`losses.counts`) in place of single spikes
through a surrogate gradient; whole views every step; long windows where the scene is taken for still, short ones
integrated over instants where it moves; sensor noise as the variance of a count; our points; a cap in place of
densification; our rates and kernels.
"""

from dataclasses import replace

from reconstruction.methods.definition import Method, RateFactors, SpikeSampling, Training, seeded

SPIKES_ALONE = SpikeSampling(every=1, size_px=None)
# Of Dy-SpikeGS: the best of twelve trials (171), with half the rates of movers (172).
SEARCHED = RateFactors(still=0.879, moving=0.458, motion=3.272)
SPIKEGS = Method(
    "spikegs",
    seeded("seed_cloud"),
    moves=False,
    supervision="counts",
    training=Training(spikes=replace(SPIKES_ALONE, planes=(64, 4096))),
)
DY_SPIKEGS = Method(
    "dy-spikegs",
    seeded("seed_field"),
    canonical=0.5,
    supervision="counts",
    watched=True,
    training=Training(rates=SEARCHED, spikes=SPIKES_ALONE),
)
