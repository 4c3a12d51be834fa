"""SpikeGS and Dy-SpikeGS: Gaussians that learn from spikes alone, of a still scene and of a deformed one.

Source: Yu et al., "SpikeGS: Learning 3D Gaussian fields from continuous spike stream", ACCV 2024 (two other papers
have that name); Spike4DGS names both as baselines. As published: no image is made of the spikes; what is rendered goes
through a model of the integrate-and-fire pixel and is compared with the recorded spikes; SpikeGS takes the scene for
still, Dy-SpikeGS deforms it.
Not published: the weights and rates of either, and how noise is embedded. Dy-SpikeGS is described as the static method
with the deformation network of 4DGS; ours deforms by the small network of Yang et al. (`gaussians.deformation`), which
is of another form. Also ours: the expected count of a pixel whose phase is random over a window (`losses.counts`) in
place of single spikes through a surrogate gradient; whole views every step; long windows where the scene is taken for
still, short ones integrated over instants where it moves; sensor noise as the variance of a count; our points; a cap in
place of densification, half as many Gaussians as the other models for Dy-SpikeGS; our rates and kernels.
"""

from dataclasses import replace

from reconstruction.methods.definition import Method, SpikeSampling, Training, seeded

SPIKES_ALONE = SpikeSampling(every=1, size_px=None)
SPIKEGS = Method(
    "spikegs",
    seeded("seed_cloud"),
    moves=False,
    supervision="counts",
    training=Training(spikes=replace(SPIKES_ALONE, planes=(64, 4096))),
)
DY_SPIKEGS = Method(
    "dy-spikegs",
    seeded("seed_field", kind="deformation"),
    canonical=0.5,
    supervision="counts",
    watched=True,
    training=Training(spikes=SPIKES_ALONE),
    gaussians=24_000,  # with 48,000 it makes two thirds of the steps in a minute, and is 0.4 dB behind
)
