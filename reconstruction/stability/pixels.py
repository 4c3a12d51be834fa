"""Defines cases of pixels and cameras that answer light like no other: maps and gains at their limits."""

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import background
from reconstruction.images.catalogue import method
from reconstruction.images.composite import CompositeSource
from reconstruction.images.failures import failing_pixels
from reconstruction.images.flicker import Light
from reconstruction.images.pixels import PixelCalibration
from reconstruction.images.response import NEVER, Response
from reconstruction.initialization.gains import camera_gains
from reconstruction.initialization.sweep import DepthMap
from reconstruction.stability.case import Case, Observation, refusal
from rigs.camera import Camera
from rigs.transform import Transform

SIZE = (13, 18)  # rows, columns
PLANES, PERIOD = 160, 4  # planes of a clip, and ticks to a spike of every pixel
LIMITS = {"0": 0.0, "-1": -1.0, "NaN": math.nan, "infinity": math.inf}
VIEWS, FOCAL_PX, DEPTH_M, BASELINE_M = 3, 40.0, 2.0, 0.05  # the cameras are one pixel apart at that depth
WALL = (40, 50)  # rows, columns


def _maps(gain: NDArray[np.float32], hot: NDArray[np.bool_]) -> PixelCalibration:
    return PixelCalibration(gain, np.zeros(gain.shape, np.float32), hot, np.zeros_like(hot))


def _stream(spikes: NDArray[np.uint8]) -> SpikeStream:
    layout = PlaneLayout(spikes.shape[2], spikes.shape[1])
    return SpikeStream(pack(spikes, layout), layout, 20000.0)


def _even() -> SpikeStream:
    """Return a clip in which every pixel fires once in PERIOD ticks, each in its own phase."""
    ticks, phases = np.arange(PLANES)[:, None, None], np.arange(math.prod(SIZE)).reshape(SIZE) * 7
    return _stream(((ticks + phases) % PERIOD == 0).astype(np.uint8))


def _refused(limit: str) -> Observation:
    """Give a map one gain that no pixel has."""
    gain = np.ones(SIZE, np.float32)
    gain[3, 4] = LIMITS[limit]
    refused = refusal(lambda: _maps(gain, np.zeros(SIZE, bool)))
    return Observation(f"refused: {refused}" if refused else "taken", 0.0 if refused else math.inf)


def _seen(response: Response) -> float:
    """Return how far background, image and counts of an even clip are from its light, in spikes per tick."""
    stream, light, moving = _even(), Light.steady(PLANES), np.ones(SIZE, dtype=bool)
    still = background(stream, moving, light, response)
    source = CompositeSource(stream, still, moving, method("interpolated"), light, response=response)
    parts = (still.image, source.at(PLANES // 2), source.counts(0, PLANES)[~source.useless(1)] / PLANES)
    gaps = [np.abs(part - 1 / PERIOD) for part in parts if part.size]
    return max(float(gap.max()) if np.isfinite(gap).all() else math.inf for gap in gaps)


def _extreme(gain: str) -> Observation:
    """Give a map gains that are finite and senseless."""
    gains = np.ones(SIZE, np.float32)
    gains[2, 3:6] = float(gain)
    response = Response.calibrated(_maps(gains, np.zeros(SIZE, bool)))
    left_out = int(response.useless(1).sum())
    error = _seen(response)
    return Observation(f"{left_out} of 3 left out, light {error:.0e} off", error if left_out == 3 else math.inf)


def _hot(good: int) -> Observation:
    """Give a map on which all pixels are hot but so many."""
    hot = np.ones(SIZE, dtype=bool)
    hot.flat[: good * 7 : 7] = False
    error = _seen(Response.calibrated(_maps(np.ones(SIZE, np.float32), hot)))
    return Observation(f"{good} good pixels, light {error:.0e} off", error)


def _camera(gain: str) -> Observation:
    """Give one of three cameras a gain at its limit, and find the gains of all."""
    rng = np.random.default_rng(1)
    wall = rng.uniform(0.2, 0.6, (WALL[0], WALL[1] + VIEWS)).astype(np.float32)
    lens = (WALL[1], WALL[0], FOCAL_PX, FOCAL_PX, WALL[1] / 2, WALL[0] / 2)
    maps, images = [], []
    for number in range(VIEWS):
        pose = Transform(np.eye(3), np.array([-BASELINE_M * number, 0.0, 0.0]))
        depth = np.full(WALL, DEPTH_M, np.float32)
        maps.append(DepthMap(Camera(f"cam0{number}", *lens, pose), depth, np.zeros_like(depth)))
        with np.errstate(invalid="ignore"):
            images.append(wall[:, number : number + WALL[1]] * np.float32(gain if number == 0 else 1))
    found = camera_gains(maps, images, [np.ones(WALL, dtype=bool)] * VIEWS)
    sane = bool(np.isfinite(found.logs).all()) and not found.determined
    return Observation("left alone" if sane else f"log gains {found.logs}", 0.0 if sane else math.inf)


def _nothing_fails(what: str) -> Observation:
    """Look for pixels that fail in clips where none does."""
    levels = {"dark": 0, "saturated": 1}
    planes = 1 if what == "one plane" else PLANES
    clip = _even() if what == "even" else _stream(np.full((planes, *SIZE), levels.get(what, 1), np.uint8))
    found = int((failing_pixels(clip, Light.steady(len(clip))) != NEVER).sum())
    return Observation(f"{found} found", float(found))


CASES = (
    *(
        Case(None, f"a map with a gain of {limit}", "refused in one line", 0.0, lambda _, limit=limit: _refused(limit))
        for limit in LIMITS
    ),
    *(
        Case(
            None, f"a map with gains of {gain}", "left out, light as around", 1e-3, lambda _, gain=gain: _extreme(gain)
        )
        for gain in ("1e-30", "1e30")
    ),
    *(
        Case(None, f"all pixels hot but {good}", "finite, light as the good ones", 1e-3, lambda _, n=good: _hot(n))
        for good in (0, 1, 2)
    ),
    *(
        Case(None, f"a camera with a gain of {gain}", "the others left alone", 0.0, lambda _, gain=gain: _camera(gain))
        for gain in ("0", "1e-30", "inf", "nan")
    ),
    *(
        Case(None, f"failing pixels, {what}", "none found", 0.0, lambda _, what=what: _nothing_fails(what))
        for what in ("dark", "saturated", "even", "one plane")
    ),
)
