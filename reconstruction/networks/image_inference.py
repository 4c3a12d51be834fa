"""Runs a trained network over a whole image: in tiles where it is large, padded where its stride asks for it."""

import functools
from pathlib import Path

import numpy as np
import torch
from torch import nn

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.networks.image_networks import ImageNetwork, evaluated, image_network
from reconstruction.networks.rates import Floats
from reconstruction.networks.weights import SHIPPED, read_weights

TILE, MARGIN = 512, 32  # pixels; MARGIN is more than the networks that ship look sideways
ENOUGH_LIGHT, MOST_GROUP = 0.05, 15  # spikes per tick that a dim image is brought to; planes. Development seed 1


def infer(
    network: ImageNetwork, module: nn.Module, stream: SpikeStream, plane: int, seen: torch.Tensor | None = None
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


@functools.cache
def trained(name: str, weights: Path | None = None) -> nn.Module:
    """Load the network `name` with `weights`, by default those that ship; raises BadRunError where there are none."""
    module = image_network(name).build().eval()
    read_weights(weights or SHIPPED / f"{name}.npz", module)
    return module
