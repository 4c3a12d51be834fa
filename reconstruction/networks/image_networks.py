"""The image networks by name: their input, their module and their loss."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.networks.blind_spot import BlindSpotNet, blind_rates, reversed_blind_rates
from reconstruction.networks.rates import BINS, RAW_REACH, REACH, planes_around, rates
from reconstruction.networks.spk2imgnet_published import PublishedSpk2ImgNet
from reconstruction.networks.spk2imgnet_small import SmallSpk2ImgNet, window_means

LEAST_LIGHT = 1e-3  # spikes per tick; a darker image is treated as this bright on average
BEND = 0.05  # error from which errors count linearly, as a share of the mean light
NOISE_BEND = 2.0  # the same for a noisy target, whose mean is wanted and not its median; a hot pixel is beyond it
SIGMA_WEIGHT = 0.02
_reversed = partial(np.flip, axis=-3)


@dataclass(frozen=True)
class ImageNetwork:
    """A network: `observe` gives its input [C, H, W], `level` the mean light [N, 1, 1, 1] of a batch of them.

    `build` makes the module, (input, level) to (light, sigma); `reverse` turns the time of inputs [..., C, H, W] round.
    `interval` is the target [N, 1, H, W] that an input itself holds, for one that trains without the true light. Errors
    count quadratically up to `bend` of the mean light. `reach` is how many planes it looks to either side.
    """

    observe: Callable[[SpikeStream, int], NDArray]
    level: Callable[[Tensor], Tensor]
    build: Callable[[], nn.Module]
    reverse: Callable[[NDArray], NDArray] = _reversed
    interval: Callable[[Tensor], Tensor] | None = None
    bend: float = BEND
    reach: int = REACH


def loss(network: ImageNetwork, module: nn.Module, seen: Tensor, truth: Tensor | None) -> Tensor:
    """Return a batch's loss: the light's error, quadratic then linear, and the likelihood of `sigma` given that error.

    The likelihood moves sigma alone, so that the light is not traded against it. Without `truth` only a network that
    has its target in its input can be trained: BadRunError.
    """
    target = network.interval(seen) if network.interval else truth
    if target is None:
        raise BadRunError("found no true light to train this network on", "clips that have it", "use blindspot")
    level = network.level(seen)
    light, sigma = module(seen, level)
    return light_loss(light, sigma, target, level, network.bend)


def light_loss(light: Tensor, sigma: Tensor, target: Tensor, level: Tensor, bend: float = BEND) -> Tensor:
    """Return the loss of light and its deviation against the target [N, 1, H, W], at mean light [N, 1, 1, 1]."""
    error, spread = (light - target) / level, sigma / level
    found = functional.huber_loss(error, torch.zeros_like(error), delta=bend)
    likelihood = spread.log() + (error.detach() / spread) ** 2 / 2
    return found / BEND + SIGMA_WEIGHT * likelihood.mean()


def image_network(name: str) -> ImageNetwork:
    """Return the network called `name`; raises BadRunError listing the known ones."""
    if name not in IMAGE_NETWORKS:
        raise BadRunError(f"found the network {name!r}", f"one of {', '.join(IMAGE_NETWORKS)}")
    return IMAGE_NETWORKS[name]


def evaluated(module: nn.Module, seen: Tensor, level: Tensor) -> tuple[Tensor, Tensor]:
    """Return light and sigma [N, 1, H, W] by `module`; the border is repeated up to a multiple of its stride."""
    height, width = seen.shape[2:]
    stride = int(module.stride)  # pyright: ignore[reportArgumentType]
    padded = functional.pad(seen, (0, -width % stride, 0, -height % stride), mode="replicate")
    light, sigma = module(padded, level)
    return light[..., :height, :width], sigma[..., :height, :width]


def _interval(seen: Tensor) -> Tensor:
    return seen[:, BINS // 2, None]


def _mean_rate(seen: Tensor) -> Tensor:
    longest = window_means()[-1, None].to(seen)
    return _mean(functional.conv2d(seen[:, :BINS], longest))


def _mean(seen: Tensor) -> Tensor:
    return seen.mean(dim=(1, 2, 3), keepdim=True).clamp_min(LEAST_LIGHT)


IMAGE_NETWORKS: Mapping[str, ImageNetwork] = {
    "small": ImageNetwork(rates, _mean_rate, SmallSpk2ImgNet),
    "published": ImageNetwork(partial(planes_around, reach=RAW_REACH), _mean, PublishedSpk2ImgNet, reach=RAW_REACH),
    "blindspot": ImageNetwork(blind_rates, _mean_rate, BlindSpotNet, reversed_blind_rates, _interval, NOISE_BEND),
}
