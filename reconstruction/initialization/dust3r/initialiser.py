"""Poses and points by DUSt3R: every pair of images through the network, all pairs laid on one another.

When to use it: little overlap or texture, where features fail. It needs a checkpoint that the user supplies (the public
ones are under CC BY-NC-SA, so none is shipped) and, on a CPU, minutes. Precision is that of the network, well behind
`sfm` where that works. Source: Wang et al., "DUSt3R: geometric 3D vision made easy", CVPR 2024.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition.progress import Progress, part, silent
from reconstruction.errors import BadRunError
from reconstruction.initialization.dust3r.alignment import aligned
from reconstruction.initialization.dust3r.pairs import PairMaps, complete, rays_of, sampled_pixels
from reconstruction.initialization.geometry import Geometry, Images, laid_on, toned, usable_views
from reconstruction.networks.dust3r.checkpoint import load_network
from reconstruction.networks.dust3r.network import Dust3r
from rigs.camera import Camera
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
    rows, columns = sampled_pixels(*_common_size(seen.cameras), MOST_PIXELS)
    tones = toned({c: images[c] for c in views})
    edges = complete(len(views))
    pairs = predicted(network, [tones[c] for c in views], edges, (rows, columns), part(progress, 0, 0.8))
    found = aligned(views, rays_of(seen.cameras, rows, columns), pairs, part(progress, 0.8, 1))
    turned = (replace(c, cam_from_rig=pose) for c, pose in zip(seen.cameras, found.cam_from_world, strict=True))
    estimated, similarity, placed = laid_on(rig, replace(seen, cameras=tuple(turned)))
    kept = found.confidence > LEAST_CONFIDENCE * found.confidence.mean()
    residuals = {c: float(off) for c, off in zip(seen.ids, found.residuals, strict=True)}
    report = {"pairs": len(pairs), "focal": "rig", "method": "dust3r", "points": int(kept.sum())}
    points, confidence = similarity.apply(found.points[kept]), found.confidence[kept].astype(np.float32)
    return Geometry(estimated, points, confidence, report=placed | report | {"residual_of_depth": residuals})


def _common_size(cameras: Sequence[Camera]) -> tuple[int, int]:
    """Return the height and width that all images have."""
    first = cameras[0]
    for camera in cameras:
        if (camera.width, camera.height) != (first.width, first.height):
            expected = f"{first.width}x{first.height} as of {first.id}"
            found = f"found the size {camera.width}x{camera.height}"
            raise BadRunError(found, expected, "dust3r takes images of one size", where=camera.id)
    return first.height, first.width


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


def _batches(count: int) -> Iterator[slice]:
    for start in range(0, count, AT_ONCE):
        yield slice(start, min(start + AT_ONCE, count))


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
