"""A trained MSDI over the views of a rig at one instant. Letters: V views, h, w their size, H, W the working size.

Views are pinholes. Where lenses bend, the image network sees the pixels that were recorded; what it makes of them, and
the rates that the geometry looks at, are straightened once.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from acquisition.progress import Progress, silent
from acquisition.spikes.stream import SpikeStream
from reconstruction.lenses.straight import Straightening, straightening, views_of
from reconstruction.networks.image_networks import gathered, image_network, infer
from reconstruction.networks.msdi.features import channels, working_factor
from reconstruction.networks.msdi.network import Msdi, Solved
from reconstruction.networks.msdi.views import Views
from reconstruction.networks.rates import Floats, rates
from rigs.camera import Camera
from rigs.rig import Rig


@dataclass(frozen=True, eq=False)
class Inferred:
    """The network's answer for V views: `light` and `sigma` [V, h, w] in spikes per tick, cameras, depth.

    `pinholes` are the nominal rig's cameras as the views that they are seen in. `views` are those that were found, over
    pixels `factor` times as large, not yet aligned to any rig; `depth` [V, H, W] in m and its `confidence` [V, H, W]
    belong to them, cut to what the views really see. Confidence is above 1, and 0 where a camera does not reach.
    """

    light: Floats
    sigma: Floats
    pinholes: tuple[Camera, ...]
    views: Views
    solved: Solved
    depth: Floats
    confidence: Floats
    factor: int


def infer_views(
    network: Msdi, streams: Sequence[SpikeStream], nominal: Rig, plane: int, progress: Progress = silent
) -> Inferred:
    """Find the images of all `streams` at `plane`, then cameras, then depth, from the `nominal` rig of the streams."""
    factor, pinholes = working_factor(streams[0].layout.width), tuple(views_of(nominal, nominal.ids).values())
    height, width = pinholes[0].height, pinholes[0].width
    pairs = zip(nominal.cameras, pinholes, strict=True)
    ways = [None if pinhole is own else straightening(own, pinhole) for own, pinhole in pairs]
    found, look = [], partial(observed, network, plane=plane, factor=factor)
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:  # views are shared out over the cores
        for one in pool.map(look, streams, ways):
            found.append(one)
            progress(0.7 * len(found) / len(streams), f"image {len(found)} of {len(streams)}")
    light, sigma, channels_of_all = zip(*found, strict=True)
    seen = torch.cat(channels_of_all)
    progress(0.7, "poses")
    with torch.inference_mode():
        small = Views.of_rig(replace(nominal, cameras=pinholes), factor)
        solved = network.solve(seen, small)
        solved = network.solve_again(solved, (seen.shape[3], seen.shape[2]), small)
        views, rows, columns = solved.adjusted.views, -(-height // factor), -(-width // factor)
        inverse, confidence = [], []
        for view in range(len(streams)):
            progress(0.8 + 0.2 * view / len(streams), f"depth {view + 1} of {len(streams)}")
            swept = network.sweep(solved.encoded.middle, views, view)
            inverse.append(swept.inverse_depth[:rows, :columns])
            confidence.append(swept.confidence[:rows, :columns] * _reached(ways[view], factor, (rows, columns)))
        depth = (1 / torch.stack(inverse)).float().numpy()
        sure = torch.stack(confidence).numpy()
    return Inferred(np.stack(light), np.stack(sigma), pinholes, views, solved, depth, sure, factor)


def observed(
    network: Msdi, stream: SpikeStream, way: Straightening | None, plane: int, factor: int
) -> tuple[Floats, Floats, Tensor]:
    """Return light and sigma [h, w] of one view, and its channels [1, CHANNELS, H, W]; dim planes are joined.

    `way` leads from the recorded pixels to the view's; None where they are the same.
    """
    images = image_network("small")
    brighter, middle, group = gathered(stream, plane, images.reach)
    seen = torch.from_numpy(rates(brighter, middle))[None]
    light, sigma = infer(images, network.image, brighter, middle, seen)
    level = images.level(seen)
    if way:
        light, sigma = way.light(light), way.light(sigma)
        seen = torch.from_numpy(np.stack([way.light(one) for one in seen[0].numpy()]))[None]
    pair = (torch.from_numpy(light)[None, None], torch.from_numpy(sigma)[None, None])
    return light / np.float32(group), sigma / np.float32(group), channels(*pair, seen, level, factor)


def _reached(way: Straightening | None, factor: int, shape: tuple[int, int]) -> Tensor | int:
    """Return where the camera sees all of a pixel of the working size [H, W]; 1 where that is everywhere."""
    if way is None:
        return 1
    covered = np.zeros((shape[0] * factor, shape[1] * factor), bool)
    covered[: way.covered.shape[0], : way.covered.shape[1]] = way.covered
    return torch.from_numpy(covered.reshape(shape[0], factor, shape[1], factor).all(axis=(1, 3)))


def full_size(small: Floats, factor: int, height: int, width: int) -> Floats:
    """Enlarge a map [H, W] of the working size to the pixels of the view [h, w], bilinearly."""
    rows, columns = small.shape
    shape = (rows * factor, columns * factor)
    large = functional.interpolate(torch.from_numpy(small)[None, None], size=shape, mode="bilinear")
    return large[0, 0, :height, :width].numpy()
