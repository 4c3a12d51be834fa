"""The image networks by name: their input, their module and their loss, and their use on a whole image.

A large image is seen in tiles.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.networks.blind_spot import BlindSpotNet, blind_rates, reversed_blind_rates
from reconstruction.networks.rates import BINS, RAW_REACH, REACH, Floats, planes_around, rates
from reconstruction.networks.spk2imgnet_published import PublishedSpk2ImgNet
from reconstruction.networks.spk2imgnet_small import SmallSpk2ImgNet, window_means
from reconstruction.tensors import read_weights

LEAST_LIGHT = 1e-3  # spikes per tick; a darker image is treated as this bright on average
BEND = 0.05  # error from which errors count linearly, as a share of the mean light
NOISE_BEND = 2.0  # the same for a noisy target, whose mean is wanted and not its median; a hot pixel is beyond it
SIGMA_WEIGHT = 0.02
TILE, MARGIN = 512, 32  # pixels; MARGIN is more than the networks that ship look sideways
ENOUGH_LIGHT, MOST_GROUP = 0.05, 15  # spikes per tick that a dim image is brought to; planes. Development seed 1
SHIPPED = Path(__file__).parent / "weights"
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


def infer(
    network: ImageNetwork, module: nn.Module, stream: SpikeStream, plane: int, seen: Tensor | None = None
) -> tuple[Floats, Floats]:
    """Return light, not negative, and its standard deviation [H, W] in spikes per tick at `plane`; both finite.

    `seen` [1, C, H, W] is what `network` observes there, for those who have it already.
    """
    if seen is None:
        seen = torch.from_numpy(np.ascontiguousarray(network.observe(stream, plane)))[None].float()
    height, width = seen.shape[2:]
    light, sigma = torch.empty(height, width), torch.empty(height, width)
    with torch.inference_mode():
        level = network.level(seen)
        for top in range(0, height, TILE):
            for left in range(0, width, TILE):
                y0, x0 = max(0, top - MARGIN), max(0, left - MARGIN)
                tile = seen[:, :, y0 : top + TILE + MARGIN, x0 : left + TILE + MARGIN]
                inner = (slice(top, top + TILE), slice(left, left + TILE))
                cut = (slice(top - y0, top - y0 + TILE), slice(left - x0, left - x0 + TILE))
                found = evaluated(module, tile.contiguous(memory_format=torch.channels_last), level)
                for whole, part in zip((light, sigma), found, strict=True):
                    whole[inner] = part[0, 0][cut]
    return light.clamp_(min=0).numpy(), sigma.numpy()


def gathered(stream: SpikeStream, plane: int, reach: int) -> tuple[SpikeStream, int, int]:
    """Return stream, plane in it, and 1; where light is dim, planes joined in groups about `plane`, and their number.

    A group has a spike where one of its planes has; intervals so long that the networks see too few of them get shorter
    by the size of the group. Motion gets faster by it, too.
    """
    first, last = stream.around(plane, reach)
    rate = stream.counts(first, last).mean() / (last - first)
    half = int(min(MOST_GROUP, ENOUGH_LIGHT / max(rate, 1e-6)) / 2 - 0.5)
    if half < 1:
        return stream, plane, 1
    group = 2 * half + 1
    before = min(reach, max(0, plane - half) // group)
    after = min(reach, max(0, len(stream) - 1 - plane - half) // group)
    first, last = plane - half - before * group, plane + half + 1 + after * group
    planes = stream.planes(max(first, 0), min(last, len(stream)))
    if first < 0 or last > len(stream):  # not even one whole group
        return stream, plane, 1
    joined = planes.reshape(-1, group, *planes.shape[1:]).max(axis=1)
    layout = PlaneLayout(stream.layout.width, stream.layout.height)
    return SpikeStream(pack(joined, layout), layout, stream.tick_rate_hz / group), before, group


@cache
def trained(name: str, weights: Path | None = None) -> nn.Module:
    """Load the network `name` with `weights`, by default those that ship; raises BadRunError where there are none."""
    module = image_network(name).build().eval()
    read_weights(weights or SHIPPED / f"{name}.npz", module)
    return module


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
