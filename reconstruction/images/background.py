"""The pixels that ever see something move, the background that stays without movers, and the pixels a sensor has lost.

Under constant light, counts over equal windows differ by at most one spike plus shot noise. A pixel whose counts spread
wider, over long windows (slow change) or short ones (a brief passage), is moving.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.native import Address
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.flicker import Light
from reconstruction.images.mending import mended
from reconstruction.images.response import Response
from reconstruction.images.scarce import changing, is_scarce, steady_background
from reconstruction.native import Double, Int, Long, kernel

WINDOWS = 20  # equal parts of the clip
SPREAD = 2.5  # spikes a part's count may lie from the median part and still be background
MOSTLY = 0.4  # share of the parts that may show something else
CUTS = (4, 16)  # equal windows the clip is cut into, once for slow and once for brief change
SHOT = 0.05  # of the root of a count, by which counts of constant light spread more
CHANGE = 3  # smallest spread of counts that constant light does not explain
GROW_PX = 2  # a mover's edge is soft: its neighbours see it too
FULL_WHITE = 0.3  # spikes per tick; in a dimmer scene differences of intensity are smaller
GLOW = 3.0  # light of a pixel that glows, over that of its brightest neighbour
_AROUND = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
STUCK_GAP = 0.05  # spikes per tick a stuck pixel must differ from its neighbours to matter

_changed_windows = kernel("changed_windows", Address, Int, Long, Address, Double, Double, Address)


@dataclass(frozen=True, eq=False)
class Background:
    """`image` [H, W], spikes per tick: the mean of the clip, or the median part of it where `moving`.

    `trusted` [H, W] where one surface is seen most of the time; `stuck` [H, W] pixels that always or never fire.
    """

    image: NDArray[np.float32]
    trusted: NDArray[np.bool_]
    stuck: NDArray[np.bool_]


def dimming(white: float) -> float:
    """Return by what factor differences of intensity are smaller than usual in a scene of this white."""
    return min(1.0, white / FULL_WHITE)


def moving_pixels(stream: SpikeStream, light: Light) -> NDArray[np.bool_]:
    """Find the pixels [H, W] that change somewhere in the stream by more than `light` does."""
    seen = np.zeros((stream.layout.height, stream.layout.width), dtype=np.uint8)
    for windows in CUTS:
        if len(stream) // windows >= CHANGE:
            counts, gains = _windows(stream, windows, light)
            if len(gains):
                _changed_windows(counts, len(gains), seen.size, gains, CHANGE / gains.min(), SHOT, seen)
    seen = cv2.medianBlur(seen, 3)  # a lone flickering pixel is the sensor's, not the scene's
    if light.lit([(0, len(stream))]) and is_scarce(stream):
        seen = np.maximum(seen, changing(stream, light).astype(np.uint8))
    return cv2.dilate(seen, np.ones((2 * GROW_PX + 1,) * 2, dtype=np.uint8)).astype(bool)


def _windows(stream: SpikeStream, windows: int, light: Light) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
    """Count spikes over equal windows [n, H, W] that are not dark; return the gain of each window [n], too."""
    length = len(stream) // windows
    spans = light.lit([(i * length, (i + 1) * length) for i in range(windows)])
    gains = np.array([light.over(*span) for span in spans], dtype=np.float32)
    return stream.window_counts(spans), gains.astype(np.float64)


def background(
    stream: SpikeStream, moving: NDArray[np.bool_], light: Light, response: Response | None = None
) -> Background:
    """Find the background behind the `moving` pixels [H, W] in mean light; pixels of no use take what is around them.

    Pixels answer light as `response` says (None: all alike); those that fail are counted up to there.
    """
    mean = stream.counts(0, len(stream)).astype(np.float32) / np.float32(len(stream))
    stuck = stuck_pixels(mean)
    length = len(stream) // WINDOWS
    image, trusted = mean.copy(), ~moving
    if moving.any() and is_scarce(stream):
        steady, mostly = steady_background(stream, light)
        image, trusted = np.where(moving, steady, mean), ~moving | mostly
    elif length and moving.any():
        near, elsewhere = cv2.dilate(moving.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0, np.zeros_like(mean)
        found, gains = _windows(stream, WINDOWS, light)
        counts = found[:, near] / gains[:, None]
        median = np.median(counts, axis=0).astype(np.float32)
        elsewhere[near] = (np.abs(counts - median) > SPREAD).mean(axis=0)
        image[moving] = (median / np.float32(length))[moving[near]]
        trusted = ~moving | (cv2.blur(elsewhere, (3, 3)) < MOSTLY)
    if response is not None:
        _before_failures(image, stream, moving, response, light)
        image, stuck = response.light(image), stuck | response.useless(1)
    return Background(mended(image, stuck), np.asarray(trusted, dtype=bool), stuck)


def _before_failures(
    image: NDArray[np.float32], stream: SpikeStream, moving: NDArray[np.bool_], response: Response, light: Light
) -> None:
    """Write the rates that failing pixels had before they failed into an image [H, W]."""
    for end in np.unique(response.fails[(response.fails > 0) & (response.fails < len(stream))]).tolist():
        own = response.fails == end
        parts = min(WINDOWS, end)
        spans = light.lit([(end * i // parts, end * (i + 1) // parts) for i in range(parts)])
        if not spans:
            continue
        counts = [stream.counts(*span)[own] / (light.over(*span) * (span[1] - span[0])) for span in spans]
        image[own] = np.where(moving[own], np.median(counts, axis=0), np.mean(counts, axis=0))


def stuck_pixels(mean: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find pixels [H, W] that never or always fired over a clip with this mean, unlike their neighbours, or that glow.

    A pixel glows that is alone with its light: no lens draws a point of which its neighbours see so little.
    """
    gap = mean - cv2.medianBlur(mean, 3)
    glow = (gap > STUCK_GAP) & (mean > GLOW * cv2.dilate(mean, _AROUND))
    return glow | (((mean <= 0) | (mean >= 1)) & (np.abs(gap) > STUCK_GAP))
