"""TVS, a retina-like reconstruction in three layers of spiking neurons: excitation, refining, plasticity.

1. Motion local excitation: an interval unlike those before it is an event. Leaky integrate-and-fire neurons, one a
   pixel, are fed by their own events and by half of their eight neighbours', and fire where something moves.
2. Spike refining: a neuron that fires cuts its pixel off from the spikes before it.
3. Plasticity: each pixel's weight follows its spikes. An interval after the last cut moves the weight towards its own
   length (potentiation, by 1 / n for the n-th, at least 1 / MEMORY); silence longer than the weight weakens it
   (depression). The image is the weight: 1 / mean interval, linear, in spikes per tick.
Order: a long mean where nothing moves, TFI where something does; it looks back, so movers trail. Cost: a dozen passes a
plane. Source: the idea of Zhu et al., "Retina-like visual image reconstruction via spiking neural model", CVPR 2020,
for which there is no public code. Ours: the form of each layer, and all constants but the 3x3 neighbourhood.
"""

import numpy as np

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate, ImageMethod
from reconstruction.images.noise import interval_sigma
from reconstruction.images.replay import Replay

UNLIKE = 1.0  # ticks beyond the mean interval that quantisation explains
LEAK = 0.9  # share of a neuron's potential that stays from tick to tick
FIRES_AT = 1.0
FED = np.array([[0.5, 0.5, 0.5], [0.5, 1.0, 0.5], [0.5, 0.5, 0.5]], dtype=np.float32)
MEMORY = 32  # intervals


def tvs(stream: SpikeStream, plane: int) -> Estimate:
    """Return the image at `plane` from each pixel's weight at its next spike."""
    import cv2

    replay = Replay(stream, plane)
    mean, potential, step, length = (np.zeros(replay.silence.shape, dtype=np.float32) for _ in range(4))
    for closed, ticks in replay:
        unlike = closed & (length > 0) & (np.abs(ticks - mean) > UNLIKE)
        potential = LEAK * potential + cv2.filter2D(unlike.astype(np.float32), -1, FED, borderType=cv2.BORDER_CONSTANT)
        excited = potential >= FIRES_AT
        length[excited & closed] = 0  # intervals since the last cut
        np.minimum(length + 1, MEMORY, out=length, where=closed)
        np.divide(ticks - mean, length, out=step, where=closed)
        np.add(mean, step, out=mean, where=closed)
        potential[excited] = 0
    valid = replay.intervals > 0
    dark = np.where(valid, np.maximum(mean, replay.silence), replay.longest + 1).astype(np.float32)
    sigma = interval_sigma(np.floor(dark).astype(np.int32)) / np.maximum(length, 1).astype(np.float32)
    return Estimate(np.reciprocal(np.maximum(dark, np.float32(1))), valid & ~replay.saturated, sigma)


METHOD = ImageMethod("tvs", tvs, price_s=0.19)
