"""A trained MSDI over the views of a rig at one instant. Letters: V views, h, w their size, H, W the working size."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from acquisition.progress import Progress, silent
from acquisition.spikes.stream import SpikeStream
from reconstruction.networks.image_networks import gathered, image_network, infer
from reconstruction.networks.msdi.features import channels, working_factor
from reconstruction.networks.msdi.network import Msdi, Solved
from reconstruction.networks.msdi.views import Views
from reconstruction.networks.rates import Floats, rates
from rigs.rig import Rig


@dataclass(frozen=True, eq=False)
class Inferred:
    """The network's answer for V views: `light` and `sigma` [V, h, w] in spikes per tick, cameras, depth.

    `views` are the cameras over pixels `factor` times as large, not yet aligned to any rig; `depth` [V, H, W] in m and
    its `confidence` [V, H, W] above 1 belong to them, cut to what the views really see.
    """

    light: Floats
    sigma: Floats
    views: Views
    solved: Solved
    depth: Floats
    confidence: Floats
    factor: int


def infer_views(
    network: Msdi, streams: Sequence[SpikeStream], nominal: Rig, plane: int, progress: Progress = silent
) -> Inferred:
    """Find the images of all `streams` at `plane`, then cameras, then depth, from the `nominal` rig of the streams."""
    height, width = streams[0].layout.height, streams[0].layout.width
    factor = working_factor(width)
    found = []
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # views are shared out over the cores
        for one in pool.map(lambda stream: observed(network, stream, plane, factor), streams):
            found.append(one)
            progress(0.7 * len(found) / len(streams), f"image {len(found)} of {len(streams)}")
    light, sigma, channels_of_all = zip(*found, strict=True)
    seen = torch.cat(channels_of_all)
    progress(0.7, "poses")
    with torch.inference_mode():
        small = Views.of_rig(nominal, factor)
        solved = network.solve(seen, small)
        solved = network.solve_again(solved, (seen.shape[3], seen.shape[2]), small)
        views, rows, columns = solved.adjusted.views, -(-height // factor), -(-width // factor)
        inverse, confidence = [], []
        for view in range(len(streams)):
            progress(0.8 + 0.2 * view / len(streams), f"depth {view + 1} of {len(streams)}")
            swept = network.sweep(solved.encoded.middle, views, view)
            inverse.append(swept.inverse_depth[:rows, :columns])
            confidence.append(swept.confidence[:rows, :columns])
        depth = (1 / torch.stack(inverse)).float().numpy()
        sure = torch.stack(confidence).numpy()
    return Inferred(np.stack(light), np.stack(sigma), views, solved, depth, sure, factor)


def observed(network: Msdi, stream: SpikeStream, plane: int, factor: int) -> tuple[Floats, Floats, Tensor]:
    """Return light and sigma [h, w] of one view, and its channels [1, CHANNELS, H, W]; dim planes are joined."""
    images = image_network("small")
    brighter, middle, group = gathered(stream, plane, images.reach)
    seen = torch.from_numpy(rates(brighter, middle))[None]
    light, sigma = infer(images, network.image, brighter, middle, seen)
    pair = (torch.from_numpy(light)[None, None], torch.from_numpy(sigma)[None, None])
    return light / np.float32(group), sigma / np.float32(group), channels(*pair, seen, images.level(seen), factor)


def full_size(small: Floats, factor: int, height: int, width: int) -> Floats:
    """Enlarge a map [H, W] of the working size to the pixels of the view [h, w], bilinearly."""
    rows, columns = small.shape
    shape = (rows * factor, columns * factor)
    large = functional.interpolate(torch.from_numpy(small)[None, None], size=shape, mode="bilinear")
    return large[0, 0, :height, :width].numpy()
