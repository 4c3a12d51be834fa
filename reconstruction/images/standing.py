"""The still content of a long recording, from the spans that it is cut into.

A pixel that is crossed in some spans is still in the others: its background is what these show alike. What stands in a
span and is not the background (something put down, or not yet taken away) differs there. Letters: S spans, H rows,
W columns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.images.background import Background, dimming
from reconstruction.images.composite import WHITE_PERCENTILE
from reconstruction.images.noise import window_sigma

UNLIKE = 0.01  # spikes per tick, mean of 3x3, by which a span's light is not that of the background
SURE = 4.0  # deviations of the noise of that mean by which it is not, too: a span by dim light has few spikes
GROW_PX = 2  # an edge is soft: its neighbours see what differs, too
ALIKE = 0.5  # least share of the spans in which a pixel is still that must show the same

Image = NDArray[np.float32]
Masks = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Standing:
    """The still content of a view: `background`, and where a span shows other things, `differs` [S, H, W]."""

    background: Background
    differs: Masks


def standing(rates: Image, moving: Masks, usual: Background, planes: Sequence[int]) -> Standing:
    """Return what stands still behind the `moving` pixels [S, H, W] of spans with the mean light `rates` [S, H, W].

    Rates are means over so many `planes` [S], in spikes per tick, without what the light as a whole does. A pixel that
    moves in every span has what the `usual` background of the whole recording says. One that is still in other spans
    than its neighbours may be like the background in none: then each span shows it otherwise.
    """
    still = ~moving
    mostly = _masked_median(rates, still)
    gaps = np.nan_to_num(np.where(still, rates - mostly, np.float32(0)))
    alike = still & ~np.stack([_differing(gap, usual.image, n) for gap, n in zip(gaps, planes, strict=True)])
    counted = alike.sum(axis=0)
    ever = counted > 0
    mean = np.where(alike, rates, 0).sum(axis=0, dtype=np.float32) / np.maximum(counted, 1)
    median = np.where(still.any(axis=0), np.nan_to_num(mostly), usual.image)
    image = np.where(ever, mean, median).astype(np.float32)
    trusted = np.where(ever, counted >= ALIKE * still.sum(axis=0), usual.trusted & ~still.any(axis=0))
    kernel = np.ones((2 * GROW_PX + 1,) * 2, np.uint8)
    differs = np.stack([cv2.dilate((s & ~a).astype(np.uint8), kernel) > 0 for s, a in zip(still, alike, strict=True)])
    return Standing(Background(image, trusted, usual.stuck), differs & still)


def unlike_share(rates: Image, others: Image, planes: int) -> float:
    """Return the share of the pixels whose mean light [H, W] over so many planes is not alike in two spans."""
    return float(_differing(rates - others, np.maximum(rates, others), planes).mean())


def _differing(gap: Image, usual: Image, planes: int) -> NDArray[np.bool_]:
    """Return where a `gap` [H, W] in light over so many planes is one that shows, beside the `usual` light [H, W]."""
    least = UNLIKE * dimming(float(np.percentile(usual, WHITE_PERCENTILE)))
    noise = window_sigma(usual, planes) * np.float32(2**0.5 / 3)  # of two means, and over 3x3 pixels
    chance = np.float32(SURE) * noise + np.float32(0.5 / planes)  # a median of counts is a whole number of spikes
    return np.abs(cv2.blur(gap, (3, 3))) > np.maximum(np.float32(least), chance)


def _masked_median(rates: Image, still: Masks) -> Image:
    """Return the lower median [H, W] over the spans in which a pixel is still; NaN where it never is."""
    ordered = np.sort(np.where(still, rates, np.float32(np.inf)), axis=0)
    middle = np.maximum(still.sum(axis=0) - 1, 0) // 2
    median = np.take_along_axis(ordered, middle[None], axis=0)[0]
    return np.where(np.isfinite(median), median, np.float32(np.nan))
