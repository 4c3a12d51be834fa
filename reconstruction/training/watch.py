"""A second look at the pixels a plan calls still, and what follows where one of them changes.

The plan tests pixel by pixel over a few long windows (`moving_pixels`), and misses what moves slowly or stands out
little. Here counts of WINDOW planes are pooled over BOX_PX x BOX_PX still pixels. Under constant light a sensor's count
is sub-Poisson: it varies by one spike's rounding (1/6) and a Fano factor of .05, so the pooled count of n pixels with m
spikes has the variance n / 6 + .05 m. A region is held to change from LEAST_PX connected pixels that depart from their
mean by more than DEVIATIONS of that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.flicker import Light
from reconstruction.initialization.seeding import LONG_LIFE
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import model_from_state
from reconstruction.training.view import TrainingView
from rigs.camera import Camera

WINDOW = 32  # planes
BOX_PX = 5
LEAST_POOLED = 8  # pixels
ROUNDING, FANO = 1 / 6, 0.05
LIGHT_ERROR = 0.008  # of a gain, where light flickers
DEVIATIONS = 8.0
LEAST_PX = 60
GROW_PX = 2
FRESH = {
    **dict.fromkeys(("velocities", "accelerations", "jerks", "turns"), 0.0),
    "instants": 0.5,
    "log_durations": math.log(LONG_LIFE),
}
BENDS = ("accelerations", "jerks")  # of straight paths these stay empty

Mask = NDArray[np.bool_]


def changed_pixels(stream: SpikeStream, still: Mask, light: Light) -> Mask:
    """Mask [H, W] of regions of `still` pixels [H, W] that change by more than `light` and noise explain."""
    strays = (deviations(stream, still, light) > DEVIATIONS).astype(np.uint8)
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(strays)
    large = np.asarray(sizes)[:, cv2.CC_STAT_AREA] >= LEAST_PX
    large[0] = False
    labels = np.asarray(labels, dtype=np.intp)
    grown = cv2.dilate(large[labels].astype(np.uint8), np.ones((2 * GROW_PX + 1,) * 2, np.uint8))
    return grown.astype(bool) & still


def deviations(stream: SpikeStream, still: Mask, light: Light) -> NDArray[np.float32]:
    """The largest departure [H, W] of a window's pooled count from the mean window, in standard deviations of one."""
    starts = range(0, len(stream) - WINDOW + 1, WINDOW)
    if len(starts) < 2:
        return np.zeros(still.shape, np.float32)
    weights = still.astype(np.float32)
    gains = [np.float32(light.over(start, start + WINDOW)) for start in starts]
    counts = (stream.counts(start, start + WINDOW).astype(np.float32) for start in starts)
    pooled = np.stack([_pooled(c * weights / gain) for c, gain in zip(counts, gains, strict=True)])
    number, mean = np.maximum(_pooled(weights), 1), pooled.mean(axis=0)
    error = LIGHT_ERROR * mean if light.flickers else np.float32(0)
    most = np.zeros(still.shape, np.float32)
    for values, gain in zip(pooled, gains, strict=True):
        sigma = np.sqrt((ROUNDING * number + FANO * mean * gain) / gain**2 + error**2)
        np.maximum(most, np.abs(values - mean) / sigma, out=most)
    return np.where(still & (number >= LEAST_POOLED), most, 0).astype(np.float32)


def _pooled(image: NDArray[np.float32]) -> NDArray[np.float32]:
    box = cv2.boxFilter(image, -1, (BOX_PX, BOX_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(box, dtype=np.float32)


def look_again(views: Sequence[TrainingView]) -> dict[int, Mask]:
    """What changes [H, W] though it is not among the moving pixels, by the number of the view; only where anything."""
    found = {}
    for i, view in enumerate(views):
        source = view.source
        changed = changed_pixels(source.stream, ~source.moving & ~source.background.stuck, source.light)
        if changed.any():
            found[i] = changed
    return found


def unsettled(means: Tensor, cameras: Sequence[Camera], changed: Mapping[int, Mask]) -> Tensor:
    """Which of `means` [N, 3] lie in a changed pixel in more than half of the views they fall into, as a mask [N]."""
    points = means.detach().numpy().astype(np.float64)
    seen, hit = np.zeros(len(points), int), np.zeros(len(points), int)
    for i, camera in enumerate(cameras):
        pixels, inside = camera.project(points)
        seen += inside
        if i in changed:
            column, row = pixels[inside].astype(int).T
            hit[inside] += changed[i][row, column]
    return torch.from_numpy(2 * hit > seen)


def set_moving(tensors: Mapping[str, Tensor], which: Tensor, fresh: Mapping[str, float]) -> dict[str, Tensor]:
    """The tensors of a cloud, by name, with the still Gaussians of the mask `which` [N] behind the moving ones.

    `fresh` are the values their motion starts from; with zeros the same call carries an optimiser's moments over.
    """
    count, carried = int(which.sum()), {}
    for name, tensor in tensors.items():
        part, key = name.split(".")
        if part == "still":
            carried[name] = tensor[~which]
        elif part == "moving":
            carried[name] = torch.cat([tensor, tensors[f"still.{key}"][which]])
        elif key in fresh and (key not in BENDS or len(tensor)):
            rows = torch.full((count, *tensor.shape[1:]), fresh[key], dtype=tensor.dtype)
            carried[name] = torch.cat([tensor, rows])
        else:
            carried[name] = tensor
    return carried


def freed(cloud: SceneModel, which: Tensor) -> SceneModel:
    """The cloud with the still Gaussians of `which` [N] moving: at rest so far, and there all the time."""
    state = cloud.state()
    return model_from_state(state | {"tensors": set_moving(state["tensors"], which, FRESH)})
