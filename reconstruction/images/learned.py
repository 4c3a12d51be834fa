"""Makes images by a trained network, as estimates; torch is loaded with the first image."""

from pathlib import Path

import numpy as np

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import Estimate


def learned(name: str, stream: SpikeStream, plane: int, weights: Path | None = None) -> Estimate:
    """Return the image at `plane` by the network `name`, or by that of `msdi`, with `weights` instead of the shipped.

    It is valid where one of a pixel's 3x3 fired within the network's reach. `sigma` is the network's own statement,
    learnt beside the light; unlike that of other methods it knows of motion.
    """
    import cv2

    from reconstruction.networks.image_networks import gathered, image_network, infer, trained
    from reconstruction.networks.msdi.network import trained_msdi

    network = image_network("small" if name == "msdi" else name)
    module = trained_msdi(weights).image if name == "msdi" else trained(name, weights)
    brighter, middle, group = gathered(stream, plane, network.reach)
    fired = (brighter.counts(*brighter.around(middle, network.reach)) > 0).astype(np.uint8)
    light, sigma = (image / np.float32(group) for image in infer(network, module, brighter, middle))
    return Estimate(light, cv2.dilate(fired, np.ones((3, 3), np.uint8)).astype(bool), sigma)
