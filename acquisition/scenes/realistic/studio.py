"""Draws what cameras see of a setting, eight keyframes at a time: the still part once, then what movers change.

A pixel that no mover reaches has the light of the still part. Elsewhere the same rays are traced with and without
movers, and their difference is added to it. Letters: H rows, W columns, N pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.realistic.painter import COARSE_RAYS, RAYS, STILL_RAYS, Painter, look, paint
from acquisition.scenes.realistic.setting import KEYFRAMES, Setting, keyframes_s
from rigs.camera import Camera

CHUNK = 8  # keyframes that are drawn together
REACH_PX = 4  # about what coarse rays found, that is drawn too
LEAST_CHANGE = 1e-6  # of light, in spikes per tick
_STILL, _FINE, *_COARSE = range(1, 5)  # numbers of random places of rays


class Base(NamedTuple):
    """The light of still things in a camera [N]: well sampled, and with the fine and the coarse rays."""

    light: NDArray[np.float32]
    fine: NDArray[np.float32]
    coarse: tuple[NDArray[np.float32], ...]


class Studio:
    """A painter, and what its cameras see of still things."""

    def __init__(self, setting: Setting):
        self._painter = Painter(setting)
        self._bases: dict[str, Base] = {}

    def draw(self, cameras: dict[str, Camera], chunk: int) -> dict[str, NDArray[np.float32]]:
        """Return the light [k, H, W] of the k keyframes of `chunk` before each of `cameras`, under its key."""
        instants_s = keyframes_s()[chunk * CHUNK : (chunk + 1) * CHUNK]
        bases = {key: self._base(key, camera) for key, camera in cameras.items()}
        changed = self._changed(cameras, (instants_s[0], instants_s[-1]))
        drawn = {key: np.repeat(base.light[None], len(instants_s), axis=0) for key, base in bases.items()}
        for number, instant_s in enumerate(instants_s):
            self._painter.stand(float(instant_s))
            for key, camera in cameras.items():
                pixels, base = changed[key], bases[key]
                seen = paint(self._painter, self._painter.whole, camera, pixels, RAYS, _FINE)
                better = (1 - seen.covered) * (base.light[pixels] - base.fine[pixels])
                drawn[key][number, pixels] = np.maximum(seen.light + better, 0)
        return {key: light.reshape(-1, cameras[key].height, cameras[key].width) for key, light in drawn.items()}

    def look(self, camera: Camera, instant_s: float) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """Return depth and objects [H, W] at an instant."""
        self._painter.stand(instant_s)
        return look(self._painter, camera)

    def _base(self, key: str, camera: Camera) -> Base:
        if key not in self._bases:
            painter, pixels = self._painter, _all_pixels(camera)
            kinds = ((STILL_RAYS, _STILL), (RAYS, _FINE), *((COARSE_RAYS, seed) for seed in _COARSE))
            light, fine, *coarse = (paint(painter, painter.still, camera, pixels, *kind).light for kind in kinds)
            self._bases[key] = Base(light, fine, tuple(coarse))
        return self._bases[key]

    def _changed(self, cameras: dict[str, Camera], instants_s: Sequence[float]) -> dict[str, NDArray[np.uint32]]:
        """Return the pixels of each camera that movers or their shadows reach at one of two instants."""
        found = {key: np.zeros(camera.height * camera.width, dtype=bool) for key, camera in cameras.items()}
        for place, (instant_s, seed) in enumerate(zip(instants_s, _COARSE, strict=True)):
            self._painter.stand(float(instant_s))
            for key, camera in cameras.items():
                seen = paint(self._painter, self._painter.whole, camera, _all_pixels(camera), COARSE_RAYS, seed)
                change = np.abs(seen.light - self._base(key, camera).coarse[place])
                found[key] |= (change > LEAST_CHANGE) | (seen.covered > 0)
        grown = {key: _grown(mask.reshape(cameras[key].height, cameras[key].width)) for key, mask in found.items()}
        return {key: np.flatnonzero(mask).astype(np.uint32) for key, mask in grown.items()}


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
