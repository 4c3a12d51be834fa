"""Poses and points by DUSt3R: every pair of images through the network, all pairs laid on one another.

When to use it: little overlap or texture, where features fail. It needs a checkpoint that the user supplies (the public
ones are under CC BY-NC-SA, so none is shipped) and, on a CPU, minutes. Precision is that of the network, well behind
`sfm` where that works. Source: Wang et al., "DUSt3R: geometric 3D vision made easy", CVPR 2024.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition.progress import Progress, part, silent
from reconstruction.errors import BadRunError
from reconstruction.initialization.dust3r.alignment import aligned
from reconstruction.initialization.dust3r.start import PairMaps
from reconstruction.initialization.geometry import Geometry, Images, first_of_one_size, laid_on, toned, usable_views
from reconstruction.networks.dust3r.checkpoint import load_network
from reconstruction.networks.dust3r.network import Dust3r
from rigs.rig import Rig

MOST_PIXELS = 2000  # most pixels of a view that the alignment works on
AT_ONCE = 4  # images or pairs in the network
LEAST_CONFIDENCE = 0.1  # least confidence of a point, as a share of the mean


def dust3r(rig: Rig, images: Images, checkpoint: Path | None, progress: Progress = silent) -> Geometry:
    """Find poses and points from `images`: camera id to [H, W], linear, spikes per tick; the network from `checkpoint`.

    Raises BadRunError without a usable checkpoint or images, GeometryError, by name, for views that do not fit.
    """
    if checkpoint is None:
        licence = "none is shipped, for its licence (CC BY-NC-SA) forbids it"
        raise BadRunError("found no checkpoint for dust3r", "--dust3r-checkpoint FILE", licence)
    usable_views(rig, images)
    return dust3r_with(load_network(checkpoint), rig, images, progress)


def dust3r_with(network: Dust3r, rig: Rig, images: Images, progress: Progress = silent) -> Geometry:
    """Do as `dust3r` with a network at hand."""
    views = usable_views(rig, images)
    seen = rig.only(views)
    first = first_of_one_size(seen.cameras, "dust3r takes images of one size")
    rows, columns = sampled_pixels(first.height, first.width, MOST_PIXELS)
    rays = np.stack([camera.slopes(np.stack([columns + 0.5, rows + 0.5], axis=-1)) for camera in seen.cameras])
    tones = toned({c: images[c] for c in views})
    edges = list(itertools.permutations(range(len(views)), 2))
    pairs = predicted(network, [tones[c] for c in views], edges, (rows, columns), part(progress, 0, 0.8))
    found = aligned(views, rays, pairs, part(progress, 0.8, 1))
    turned = (replace(c, cam_from_rig=pose) for c, pose in zip(seen.cameras, found.cam_from_world, strict=True))
    estimated, similarity, placed = laid_on(rig, replace(seen, cameras=tuple(turned)))
    kept = found.confidence > LEAST_CONFIDENCE * found.confidence.mean()
    residuals = {c: float(off) for c, off in zip(seen.ids, found.residuals, strict=True)}
    report = {"pairs": len(pairs), "focal": "rig", "method": "dust3r", "points": int(kept.sum())}
    points, confidence = similarity.apply(found.points[kept]), found.confidence[kept].astype(np.float32)
    return Geometry(estimated, points, confidence, report=placed | report | {"residual_of_depth": residuals})


def sampled_pixels(height: int, width: int, most: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns [n] of an even grid of at most `most` pixels."""
    stride = max(1, int(np.ceil(np.sqrt(height * width / most))))
    rows, columns = np.meshgrid(*(np.arange(stride // 2, side, stride) for side in (height, width)), indexing="ij")
    return rows.ravel(), columns.ravel()


@torch.no_grad()
def predicted(
    network: Dust3r,
    tones: Sequence[NDArray[np.float32]],
    edges: Sequence[tuple[int, int]],
    pixels: tuple[NDArray[np.intp], NDArray[np.intp]],
    progress: Progress = silent,
) -> list[PairMaps]:
    """Show the network each pair in `edges`, and return what it says at the sampled `pixels`.

    Images are padded to whole patches on all sides with their outermost pixels. Each is encoded once.
    """
    padded, (top, left) = padded_images(tones, network.architecture.patch_px)
    grid = network.grid(padded)
    encoded = []
    for batch in _batches(len(tones)):
        progress(0.3 * batch.start / len(tones), "encoding images")
        encoded.append(network.encode(padded[batch]))
    tokens = torch.cat(encoded)
    rows, columns = (torch.from_numpy(axis + shift) for axis, shift in zip(pixels, (top, left), strict=True))
    pairs = []
    for batch in _batches(len(edges)):
        progress(0.3 + 0.7 * batch.start / len(edges), "decoding pairs")
        first, second = (tokens[list(side)] for side in zip(*edges[batch], strict=True))
        maps = network(first, second, grid)
        points = torch.stack([m.points[:, rows, columns] for m in maps], dim=1).numpy()
        confidence = torch.stack([m.confidence[:, rows, columns] for m in maps], dim=1).numpy()
        pairs += [PairMaps(*edge, p, c) for edge, p, c in zip(edges[batch], points, confidence, strict=True)]
    return pairs


def _batches(count: int) -> list[slice]:
    return [slice(start, start + AT_ONCE) for start in range(0, count, AT_ONCE)]


def padded_images(tones: Sequence[NDArray[np.float32]], patch_px: int) -> tuple[Tensor, tuple[int, int]]:
    """Pad grey images [H, W] in [0, 1] to whole patches [v, 3, H', W'] in [-1, 1], by some rows and columns before.

    As many are added behind, or one more.
    """
    height, width = tones[0].shape
    more = [-size % patch_px for size in (height, width)]
    before = [n // 2 for n in more]
    margins = [(b, n - b) for b, n in zip(before, more, strict=True)]
    stack = np.stack([np.pad(tone, margins, mode="edge") for tone in tones])
    return torch.from_numpy(2 * stack - 1)[:, None].expand(-1, 3, -1, -1), (before[0], before[1])
