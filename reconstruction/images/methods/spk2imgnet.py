"""Spk2ImgNet: a convolutional network trained on random scenes, whose truth is exact.

Order: sharp under motion and quiet where nothing moves, because it has learnt how long to look at each pixel. It looks
64 planes to either side; beyond the ends of a stream it sees the mirror image. Cost: about a second a core at 400x250.
Not for radiometry outside its training: it was trained on 0.01 to 0.95 spikes a tick and up to half a pixel a tick.
Two sizes: `small` (0.2 M parameters, ours, without alignment) has weights that ship; `published` (3.9 M, the paper's)
has none, and can be trained by `python -m reconstruction.networks.train network published --device cuda`.
Source: Zhao et al., "Spk2ImgNet: learning to reconstruct dynamic scene from continuous spike stream", CVPR 2021.
"""

from pathlib import Path

from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.catalogue import ImageMethod
from reconstruction.images.estimate import Estimate

TIERS = {"small": True, "published": False}  # whether weights ship


def spk2imgnet(stream: SpikeStream, plane: int, tier: str = "small", weights: Path | None = None) -> Estimate:
    """Return the image at `plane` by the network of `tier`; valid where a pixel or neighbour fired near the instant.

    `weights` are one's own for that tier. Raises BadRunError for a tier that has neither.
    """
    if tier not in TIERS or not (TIERS[tier] or weights):
        raise BadRunError(f"found the tier {tier!r} without weights", "small, or a tier and weights trained for it")
    from reconstruction.images.learned import estimated  # torch, which listing the methods does without

    return estimated(tier, stream, plane, weights)


METHOD = ImageMethod("spk2imgnet", spk2imgnet, price_s=0.48, learned=True)
