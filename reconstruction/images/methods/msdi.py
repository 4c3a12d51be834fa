"""MSDI's image network on a single stream: the small Spk2ImgNet, trained further beside MSDI's geometry.

Order and cost are those of `spk2imgnet`, whose weights it started from. Source: `reconstruction.networks.msdi.network`.
"""

from pathlib import Path

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import ImageMethod
from reconstruction.images.estimate import Estimate


def msdi(stream: SpikeStream, plane: int, weights: Path | None = None) -> Estimate:
    """Return the image at `plane`; valid where a pixel or its neighbour ever fired near the instant.

    `weights` are those of an MSDI of the user's own.
    """
    from reconstruction.images.learned import estimated_by  # torch, which listing the methods does without
    from reconstruction.networks.image_networks import image_network
    from reconstruction.networks.msdi.network import trained_msdi

    return estimated_by(image_network("small"), trained_msdi(weights).image, stream, plane)


METHOD = ImageMethod("msdi", msdi, price_s=0.48, learned=True)
