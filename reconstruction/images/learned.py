"""Makes images by a trained network, as estimates."""

from pathlib import Path

import cv2
import numpy as np
from torch import nn

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.estimate import Estimate
from reconstruction.networks.image_inference import gathered, infer, trained
from reconstruction.networks.image_networks import ImageNetwork, image_network


def estimated(name: str, stream: SpikeStream, plane: int, weights: Path | None) -> Estimate:
    """Return the image at `plane` by the network `name` with `weights`, by default those that ship."""
    return estimated_by(image_network(name), trained(name, weights), stream, plane)


def estimated_by(network: ImageNetwork, module: nn.Module, stream: SpikeStream, plane: int) -> Estimate:
    """Return the image at `plane` by a trained `module`; valid where one of a pixel's 3x3 fired within its reach.

    `sigma` is the network's own statement, learnt beside the light; unlike that of other methods it knows of motion.
    """
    brighter, middle, group = gathered(stream, plane, network.reach)
    fired = (brighter.counts(*brighter.around(middle, network.reach)) > 0).astype(np.uint8)
    light, sigma = (image / np.float32(group) for image in infer(network, module, brighter, middle))
    return Estimate(light, cv2.dilate(fired, np.ones((3, 3), np.uint8)).astype(bool), sigma)
