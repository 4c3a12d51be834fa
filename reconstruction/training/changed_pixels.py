"""Looks a second time at the pixels that a plan calls still, and finds the regions that change after all.

The plan tests pixel by pixel over a few long windows (`images.background`), and misses what moves slowly or stands
out little. Here counts of WINDOW planes are pooled over BOX_PX x BOX_PX still pixels. Under constant light a sensor's
count is sub-Poisson: it varies by one spike's rounding (1/6) and a Fano factor of .05, so the pooled count of n pixels
with m spikes has the variance n / 6 + .05 m. A region changes where LEAST_PX or more connected pixels depart from their
mean by more than DEVIATIONS standard deviations.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.flicker import Light
from reconstruction.lenses.straight import Straightening
from reconstruction.training.view import TrainingView
from rigs.camera import Camera

WINDOW = 32  # planes of a count
BOX_PX = 5  # width of the square that counts are pooled over
LEAST_POOLED = 8  # still pixels in a square, at least
ROUNDING, FANO = 1 / 6, 0.05  # spikes^2 of variance a pixel, and a spike
LIGHT_ERROR = 0.008  # relative error of a gain, where light flickers
DEVIATIONS = 8.0  # standard deviations beyond which a pixel has changed
LEAST_PX = 60  # connected pixels of a region that changed, at least
GROW_PX = 2  # pixels by which a region is grown

Mask = NDArray[np.bool_]


def changed_pixels(stream: SpikeStream, still: Mask, light: Light, way: Straightening | None = None) -> Mask:
    """Return the mask [H, W] of regions of `still` pixels [H, W] that change more than `light` and noise explain.

    `way`: how the stream's counts came from recorded pixels; None where they are counts of these.
    """
    strays = (deviations(stream, still, light, way) > DEVIATIONS).astype(np.uint8)
    _, labels, sizes, _ = cv2.connectedComponentsWithStats(strays)
    large = np.asarray(sizes)[:, cv2.CC_STAT_AREA] >= LEAST_PX
    large[0] = False
    labels = np.asarray(labels, dtype=np.intp)
    grown = cv2.dilate(large[labels].astype(np.uint8), np.ones((2 * GROW_PX + 1,) * 2, np.uint8))
    return grown.astype(bool) & still


def deviations(stream: SpikeStream, still: Mask, light: Light, way: Straightening | None = None) -> NDArray[np.float32]:
    """Return the largest departure [H, W] of a window's pooled count from the mean one, in standard deviations."""
    windows = [(start, start + WINDOW) for start in range(0, len(stream) - WINDOW + 1, WINDOW)]
    starts = [start for start, _ in light.lit(windows)]
    if len(starts) < 2:
        return np.zeros(still.shape, np.float32)
    weights = still.astype(np.float32)
    gains = [np.float32(light.over(start, start + WINDOW)) for start in starts]
    counts = (stream.counts(start, start + WINDOW).astype(np.float32) for start in starts)
    pooled = np.stack([_pooled(c * weights / gain) for c, gain in zip(counts, gains, strict=True)])
    number, mean = np.maximum(_pooled(weights), 1), pooled.mean(axis=0)
    spread = np.float32(1)
    if way is not None:  # a sum over many pixels has the noise of as many recorded ones as lie there
        spread = np.maximum(
            _pooled((weights / np.maximum(way.exposure, 0.1)).astype(np.float32)) / number, np.float32(0.1)
        )
    error = LIGHT_ERROR * mean if light.flickers else np.float32(0)
    most = np.zeros(still.shape, np.float32)
    for values, gain in zip(pooled, gains, strict=True):
        sigma = np.sqrt(spread * (ROUNDING * number + FANO * mean * gain) / gain**2 + error**2)
        np.maximum(most, np.abs(values - mean) / sigma, out=most)
    return np.where(still & (number >= LEAST_POOLED), most, 0).astype(np.float32)


def _pooled(image: NDArray[np.float32]) -> NDArray[np.float32]:
    box = cv2.boxFilter(image, -1, (BOX_PX, BOX_PX), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(box, dtype=np.float32)


def look_again(views: Sequence[TrainingView]) -> dict[int, Mask]:
    """Return the still pixels [H, W] that change, by the number of the view; views without any are left out."""
    found = {}
    for i, view in enumerate(views):
        source = view.source
        still = ~source.moving & ~source.useless(len(source.stream))
        changed = changed_pixels(source.stream, still, source.light, source.straightening)
        if changed.any():
            found[i] = changed
    return found


def unsettled(means: Tensor, cameras: Sequence[Camera], changed: Mapping[int, Mask]) -> Tensor:
    """Return the mask [N] of `means` [N, 3] (m, rig frame) that lie in changed pixels in most views they fall into."""
    points = means.detach().cpu().numpy().astype(np.float64)
    seen, hit = np.zeros(len(points), int), np.zeros(len(points), int)
    for i, camera in enumerate(cameras):
        pixels, inside = camera.project(points)
        seen += inside
        if i in changed:
            column, row = pixels[inside].astype(int).T
            hit[inside] += changed[i][row, column]
    return torch.from_numpy(2 * hit > seen)
