"""A trained MSDI over the views of a rig at one instant. Letters: V views, h, w their size, H, W the working size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from acquisition.progress import Progress, silent
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.learned.inference import infer
from reconstruction.images.learned.models import model
from reconstruction.images.learned.observation import rates
from reconstruction.initialization.msdi.features import channels, working_factor
from reconstruction.initialization.msdi.network import SmallMsdi, Solved
from reconstruction.initialization.msdi.views import Views

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Inferred:
    """What the network says of V views: `light` and `sigma` [V, h, w] in spikes per tick, cameras, depth.

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
    network: SmallMsdi, streams: Sequence[SpikeStream], nominal: Views, plane: int, progress: Progress = silent
) -> Inferred:
    """Images of all `streams` at `plane`, then the cameras, then depth. `nominal` is over pixels of the full size."""
    height, width = streams[0].layout.height, streams[0].layout.width
    factor = working_factor(width)
    light, sigma, seen = [], [], []
    for number, stream in enumerate(streams):
        progress(0.7 * number / len(streams), f"image {number + 1} of {len(streams)}")
        image, error, channel = observed(network, stream, plane, factor)
        light.append(image)
        sigma.append(error)
        seen.append(channel)
    progress(0.7, "poses")
    with torch.inference_mode():
        channel_maps = torch.cat(seen)
        small = smaller(nominal, factor)
        solved = network.solve(channel_maps, small)
        solved = network.solve_again(solved, (channel_maps.shape[3], channel_maps.shape[2]), small)
        rows, columns = -(-height // factor), -(-width // factor)
        inverse, confidence = [], []
        for view in range(len(streams)):
            progress(0.8 + 0.2 * view / len(streams), f"depth {view + 1} of {len(streams)}")
            swept = network.sweep(solved.encoded.middle, solved.adjusted.views, view)
            inverse.append(swept.inverse_depth[:rows, :columns])
            confidence.append(swept.confidence[:rows, :columns])
    depth = 1 / torch.stack(inverse).numpy()
    views = solved.adjusted.views
    return Inferred(np.stack(light), np.stack(sigma), views, solved, depth, torch.stack(confidence).numpy(), factor)


def observed(network: SmallMsdi, stream: SpikeStream, plane: int, factor: int) -> tuple[Floats, Floats, Tensor]:
    """Light and sigma [h, w] of one view, and its channels [1, CHANNELS, H, W]."""
    images = model("small")
    seen = torch.from_numpy(rates(stream, plane))[None]
    light, sigma = infer(images, network.image, stream, plane, seen)
    level = images.level(seen)
    pair = (torch.from_numpy(light)[None, None], torch.from_numpy(sigma)[None, None])
    return light, sigma, channels(*pair, seen, level, factor)


def smaller(views: Views, factor: int) -> Views:
    """The same cameras over pixels `factor` times as large."""
    return Views(views.rotation, views.center, views.focal / factor, views.principal / factor, views.distance)


def full_size(small: Floats, factor: int, height: int, width: int) -> Floats:
    """A map [H, W] of the working size over the pixels of the view [h, w], bilinear."""
    rows, columns = small.shape
    shape = (rows * factor, columns * factor)
    large = functional.interpolate(
        torch.from_numpy(small)[None, None], size=shape, mode="bilinear", align_corners=False
    )
    return large[0, 0, :height, :width].numpy()
