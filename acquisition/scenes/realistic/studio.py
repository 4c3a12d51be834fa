"""Draws what cameras see of a setting, eight keyframes at a time: the still part once, then what movers change.

A pixel that no mover reaches has the settled light of the still part. Elsewhere the same few rays are traced with and
without movers, and their difference is added to it. Letters: H rows, W columns, N pixels, k keyframes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.realistic.painter import COARSE_RAYS, RAYS, Painter, look, paint
from acquisition.scenes.realistic.setting import KEYFRAMES, Setting, keyframes_s
from acquisition.scenes.realistic.settled import settled
from rigs.camera import Camera

CHUNK = 8  # keyframes that are drawn together
REACH_PX = 4  # about what coarse rays found, that is drawn too
LEAST_CHANGE = 1e-6  # of light, in spikes per tick
_FINE, *_COARSE = range(1, 4)  # numbers of random places of rays; those of settled light are large
Image = NDArray[np.float32]


class Base(NamedTuple):
    """The light of still things in a camera [N]: settled, and with the fine and the coarse rays."""

    light: Image
    fine: Image
    coarse: tuple[Image, ...]


class Studio:
    """A painter, and what its cameras see of still things."""

    def __init__(self, setting: Setting):
        self._painter = Painter(setting)
        self._bases: dict[Camera, Base] = {}

    def draw(self, cameras: Sequence[Camera], chunk: int) -> list[Image]:
        """Return the light [k, H, W] of the k keyframes of `chunk` before each of `cameras`."""
        instants_s = keyframes_s()[chunk * CHUNK : (chunk + 1) * CHUNK]
        bases = [self._base(camera) for camera in cameras]
        changed = self._changed(cameras, (instants_s[0], instants_s[-1]))
        drawn = [np.repeat(base.light[None], len(instants_s), axis=0) for base in bases]
        for number, instant_s in enumerate(instants_s):
            self._painter.stand(float(instant_s))
            for camera, pixels, base, light in zip(cameras, changed, bases, drawn, strict=True):
                seen = paint(self._painter, self._painter.whole, camera, pixels, RAYS, _FINE)
                better = (1 - seen.covered) * (base.light[pixels] - base.fine[pixels])
                light[number, pixels] = np.maximum(seen.light + better, 0)
        return [light.reshape(-1, c.height, c.width) for light, c in zip(drawn, cameras, strict=True)]

    def true_light(self, camera: Camera, instant_s: float) -> Image:
        """Return the settled light [H, W] before a camera at an instant, movers' too."""
        light = self._base(camera).light.copy()
        (pixels,) = self._changed([camera], (instant_s, instant_s))
        light[pixels] = settled(self._painter, self._painter.whole, camera, pixels)
        return light.reshape(camera.height, camera.width)

    def look(self, camera: Camera, instant_s: float) -> tuple[Image, NDArray[np.int8]]:
        """Return depth and objects [H, W] at an instant."""
        self._painter.stand(instant_s)
        return look(self._painter, camera)

    def _base(self, camera: Camera) -> Base:
        if camera not in self._bases:
            painter, pixels = self._painter, _all_pixels(camera)
            kinds = ((RAYS, _FINE), *((COARSE_RAYS, seed) for seed in _COARSE))
            fine, *coarse = (paint(painter, painter.still, camera, pixels, *kind).light for kind in kinds)
            self._bases[camera] = Base(settled(painter, painter.still, camera, pixels), fine, tuple(coarse))
        return self._bases[camera]

    def _changed(self, cameras: Sequence[Camera], instants_s: Sequence[float]) -> list[NDArray[np.uint32]]:
        """Return the pixels of each camera that movers or their shadows reach at one of two instants.

        The painter is left at the last.
        """
        found = [np.zeros(camera.height * camera.width, dtype=bool) for camera in cameras]
        for place, (instant_s, seed) in enumerate(zip(instants_s, _COARSE, strict=True)):
            self._painter.stand(float(instant_s))
            for camera, mask in zip(cameras, found, strict=True):
                seen = paint(self._painter, self._painter.whole, camera, _all_pixels(camera), COARSE_RAYS, seed)
                change = np.abs(seen.light - self._base(camera).coarse[place])
                mask |= (change > LEAST_CHANGE) | (seen.covered > 0)
        grown = (_grown(mask.reshape(c.height, c.width)) for mask, c in zip(found, cameras, strict=True))
        return [np.flatnonzero(mask).astype(np.uint32) for mask in grown]


def chunks_of(first: int, last: int) -> range:
    """Return the chunks that hold the keyframes from `first` to `last`."""
    return range(max(first, 0) // CHUNK, min(last, KEYFRAMES - 1) // CHUNK + 1)


def _all_pixels(camera: Camera) -> NDArray[np.uint32]:
    return np.arange(camera.width * camera.height, dtype=np.uint32)


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask [H, W] with everything up to REACH_PX beside it."""
    for axis in (0, 1):
        padded = np.pad(mask, [(REACH_PX, REACH_PX) if a == axis else (0, 0) for a in (0, 1)])
        size = mask.shape[axis]
        mask = np.logical_or.reduce([padded.take(range(k, k + size), axis) for k in range(2 * REACH_PX + 1)])
    return mask
