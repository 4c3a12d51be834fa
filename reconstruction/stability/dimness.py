"""Defines case 31: recordings in which little light arrives, or in which movers cross the view.

A real sensor sees known light. Masks of movers and backgrounds are held against what was there.
"""

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import DARK_LEVEL, Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import background, moving_pixels, stuck_pixels
from reconstruction.images.flicker import Light, estimate_light
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.plan import make_plan
from reconstruction.stability.case import Case, Observation, refusal
from rigs.toml import catalog_rig

HEIGHT, WIDTH, PLANES = 43, 97, 400
STEADY = Light.steady(PLANES)
BAR_PX = (slice(12, 30), 9)  # rows of a bar and its width
REACH_PX = 12  # how far from a mover a pixel may be taken for one
BLACK = 0.02  # spikes per tick, of single pixels where nothing is
WHITE = 0.6  # spikes per tick

Floats = NDArray[np.floating]


def _seen(light: Floats) -> SpikeStream:
    """Return what a real sensor makes of light [T, H, W]."""
    layout = PlaneLayout(WIDTH, HEIGHT)
    return SpikeStream(
        pack(Sensor(WIDTH, HEIGHT, "real", 5, 0).expose(light.astype(np.float32)), layout), layout, 20000.0
    )


def _wall(white: float) -> Floats:
    return white * np.random.default_rng(3).uniform(0.2, 0.6, (HEIGHT, WIDTH))


def _crossing(white: float, wall: Floats, motion_px: float) -> tuple[SpikeStream, NDArray[np.bool_]]:
    """Return a textured bar that gets `motion_px` far before the wall, and the pixels [H, W] whose light it changes."""
    light, (rows, width) = np.tile(wall, (PLANES, 1, 1)), BAR_PX
    print_on = white * np.random.default_rng(4).uniform(0.3, 1, (rows.stop - rows.start, width))
    for k in range(PLANES):
        left = 15 + round(motion_px * k / PLANES)
        light[k, rows, left : left + width] = print_on
    return _seen(light), np.ptp(light, axis=0) > 0


def _missed(stream: SpikeStream, ever: NDArray[np.bool_]) -> Observation:
    """Return the share of the moving pixels that are missed; infinite where one is made up far from any."""
    found = moving_pixels(stream, STEADY)
    rows, columns = np.nonzero(ever)
    far = np.ones_like(ever)
    far[
        max(0, rows.min() - REACH_PX) : rows.max() + REACH_PX,
        max(0, columns.min() - REACH_PX) : columns.max() + REACH_PX,
    ] = False
    made_up, missed = int((found & far).sum()), float(1 - found[ever].mean())
    return Observation(f"{missed:.1%} missed, {made_up} made up", math.inf if made_up else missed)


def _motion(motion: str) -> Observation:
    return _missed(*_crossing(WHITE, _wall(WHITE), float(motion)))


def _tenth(motion: str) -> Observation:
    return _missed(*_crossing(WHITE / 10, _wall(WHITE / 10), float(motion)))


def _black(_: str) -> Observation:
    """See one mover before nothing: it is found, and behind it stays nothing."""
    stream, ever = _crossing(WHITE, np.zeros((HEIGHT, WIDTH)), 60)
    missed, light = _missed(stream, ever), estimate_light([stream])
    behind = background(stream, moving_pixels(stream, STEADY), light)
    most = float(behind.image[behind.trusted & ~behind.stuck].max())
    sane = not light.flickers and np.isfinite(behind.image).all() and most < BLACK
    return Observation(f"{missed.said}, at most {most:.4f} behind it", missed.error if sane else math.inf)


def _hundredth(_: str) -> Observation:
    """See a still wall by a hundredth of the light: nothing moves, and no pixel is off by more than a few spikes."""
    wall = _wall(WHITE / 100)
    stream = _seen(np.tile(wall, (PLANES, 1, 1)))
    moving = moving_pixels(stream, STEADY)
    found = background(stream, moving, STEADY)
    off = np.abs(found.image - wall - DARK_LEVEL)[~found.stuck].max() * PLANES
    lone = int(stuck_pixels(found.image).sum())
    said = f"{int(moving.sum())} moving pixels, at most {off:.1f} spikes off, {lone} glow"
    return Observation(said, math.inf if moving.any() or lone else float(off))


def _one_spike(_: str) -> Observation:
    """See one spike in a whole recording: nothing moves, and a plan refuses it in one line."""
    rig = catalog_rig("ci3x3").scaled(WIDTH, HEIGHT)
    layout, streams = PlaneLayout(WIDTH, HEIGHT), {}
    for number, camera in enumerate(rig.ids):
        planes = np.zeros((PLANES, HEIGHT, WIDTH), np.uint8)
        planes[200, 20, 30] = number == 0
        streams[camera] = SpikeStream(pack(planes, layout), layout, 20000.0)
    stream = streams[rig.ids[0]]
    moving = moving_pixels(stream, STEADY)
    image = background(stream, np.ones_like(moving), STEADY).image
    error = refusal(lambda: make_plan(ReconstructionConfig(), rig, streams))
    sane = not moving.any() and bool(np.isfinite(image).all()) and error is not None and "\n" not in str(error)
    return Observation(f"{int(moving.sum())} moving pixels, refused: {error}", 0.0 if sane else math.inf)


CASES = (
    Case(31, "motion in px a clip", "found, none made up", 0.02, _motion, lambda: ("1", "5", "20", "60")),
    Case(31, "the same at a tenth of the light", "mostly found", 0.1, _tenth, lambda: ("5", "20", "60")),
    Case(31, "all black but one mover", "found, black behind it", 0.02, _black),
    Case(31, "a hundredth of the light", "still, a few spikes off", 4.0, _hundredth),
    Case(31, "one spike", "still, and refused in one line", 0.0, _one_spike),
)
