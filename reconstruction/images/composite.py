"""The best statistic for each pixel: everything recorded where nothing moves, a short image where something does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import Background, dimming
from reconstruction.images.catalogue import ImageMethod
from reconstruction.images.flicker import Light
from reconstruction.images.mending import mended
from reconstruction.images.response import Response
from reconstruction.lenses.resampling import WHOLE, Part
from reconstruction.lenses.straight import Straightening
from rigs.camera import Camera

Mask = NDArray[np.bool_]
MethodFor = Callable[[SpikeStream, Mask], ImageMethod]
DIFFERENT = 0.03  # spikes per tick, mean of 3x3: five deviations of a 33-plane TFP's quantisation
GROW_PX = 2
REACH = 5  # planes behind an image's own that it is made from, as far as they tell much
WHITE_PERCENTILE = 99.9
ROOM_BYTES = 64_000_000  # memory for a view's short images, which training asks for again and again


@dataclass(frozen=True, eq=False)
class CompositeSource:
    """One camera's target images under `light`: its background, but a short image by `method` where `moving` [H, W].

    Short images are kept, their moving pixels alone, until they fill `room_bytes`; then the first goes first. Images
    and counts are of the light behind what pixels fire, as `response` has it (None: they are all alike).
    `straightening`: how its pixels came from recorded ones; None where they are these.
    """

    stream: SpikeStream
    background: Background
    moving: NDArray[np.bool_]
    method: ImageMethod
    light: Light
    kept: dict[int, NDArray[np.float32]] = field(default_factory=dict)
    response: Response | None = None
    straightening: Straightening | None = None
    room_bytes: int = ROOM_BYTES

    @cached_property
    def white(self) -> float:
        """The brightest of the background, spikes per tick."""
        return float(np.percentile(self.background.image, WHITE_PERCENTILE))

    def at(self, plane: int) -> NDArray[np.float32]:
        """Return the image [H, W] at `plane` in spikes per tick."""
        image = self.background.image * self.light.gains[plane]
        if self.moving.any():
            image[self.moving] = self._short(plane)
        return image

    def instants(self, stride: int) -> NDArray[np.int64]:
        """Return the middles of every `stride` planes, or of all where there are fewer."""
        planes = len(self.stream)
        stride = min(stride, planes)
        return np.arange(stride // 2, planes, stride)

    def exposed(self, plane: int, planes: int) -> tuple[float, int]:
        """Return the begin and the length, in planes, of the part of the clip that an image of `planes` covers."""
        first = max(0, plane - planes // 2)
        return first, min(len(self.stream), plane + planes // 2 + 1) - first

    def _short(self, plane: int) -> NDArray[np.float32]:
        """Return the moving pixels' values at `plane`."""
        if plane not in self.kept:
            values = self._made(plane)
            while self.kept and (len(self.kept) + 1) * values.nbytes > self.room_bytes:
                self.kept.pop(next(iter(self.kept)))
            self.kept[plane] = values
        return self.kept[plane]

    def _made(self, plane: int) -> NDArray[np.float32]:
        image, useless = self.method(self.stream, plane).intensity, self.useless(plane + REACH)
        return mended(self.response.light(image) if self.response else image, useless)[self.moving]

    def counts(self, first: int, last: int, part: Part = WHOLE) -> NDArray[np.float32]:
        """Return the light [H, W] that a part of the pixels gathered over planes [first, last), in spikes."""
        length, counts = np.float32(last - first), self.stream.counts(first, last).astype(np.float32)
        return (self.response.light(counts / length) * length if self.response else counts)[part]

    def dimmed(self, gain: float) -> CompositeSource:
        """Return the images of a camera that sees `gain` times the light, with that taken out of images and counts."""
        if gain == 1:
            return self
        still = replace(self.background, image=self.background.image / np.float32(gain))
        response = self.response or Response.even(self.moving.shape)
        return replace(self, background=still, response=response.times(gain), kept={})

    def useless(self, last: int) -> NDArray[np.bool_]:
        """Return which pixels [H, W] are of no use in planes before `last`."""
        stuck = self.background.stuck
        return stuck | self.response.useless(last) if self.response else stuck

    def carried(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return a recorded image [h, w] as this source has it [H, W]."""
        return image

    def carried_mask(self, pixels: Mask) -> Mask:
        """Return the pixels [H, W] of this source that a mask of recorded ones [h, w] touches."""
        return pixels

    def recorded_mask(self, moving: Mask) -> Mask:
        """Return the recorded pixels [h, w] under a mask [H, W] of this source."""
        return moving

    def retargeted(self, moving: Mask, method_for: MethodFor) -> CompositeSource:
        """Return the same source with other pixels `moving`, imaged by what `method_for` makes of stream and pixels."""
        return replace(self, moving=moving, method=method_for(self.stream, moving), kept={})

    def part(self, first: int, last: int) -> CompositeSource:
        """Return the images of planes [first, last) as a source of their own, with the same background."""
        light, response = Light(self.light.gains[first:last]), self.response and self.response.since(first)
        return replace(self, stream=self.stream.part(first, last), light=light, response=response, kept={})

    def movers(self, image: NDArray[np.float32], plane: int) -> NDArray[np.bool_]:
        """Return which pixels of an image [H, W] at `plane` see a mover: unlike the background, or with no sure one."""
        gap = cv2.blur(image - self.background.image * self.light.gains[plane], (3, 3))
        least = DIFFERENT * dimming(self.white)
        unlike = cv2.dilate((np.abs(gap) > least).astype(np.uint8), np.ones((2 * GROW_PX + 1,) * 2, np.uint8))
        return self.moving & ((unlike > 0) | ~self.background.trusted)


@dataclass(frozen=True, eq=False)
class GivenSource(CompositeSource):
    """One camera's given images by plane, in spikes per tick, in place of those that the source `spikes` makes.

    Each is the mean light of `planes` planes around its own. Masks and counts are still those of the spikes.
    """

    spikes: CompositeSource = field(kw_only=True)
    frames: Mapping[int, NDArray[np.float32]] = field(kw_only=True)
    planes: int = field(kw_only=True)

    @classmethod
    def of(cls, spikes: CompositeSource, frames: Mapping[int, NDArray[np.float32]], planes: int) -> GivenSource:
        """Return a source of `frames` with everything else as `spikes` has it."""
        own = {one.name: getattr(spikes, one.name) for one in fields(CompositeSource)}
        return cls(**own, spikes=spikes, frames=frames, planes=planes)

    def at(self, plane: int) -> NDArray[np.float32]:
        """Return the given image [H, W] at `plane`; KeyError where there is none."""
        return self.frames[plane]

    def instants(self, stride: int) -> NDArray[np.int64]:
        """Return the planes that have an image, whatever the stride."""
        return np.array(sorted(self.frames), dtype=np.int64)

    def exposed(self, plane: int, planes: int) -> tuple[float, int]:
        """Return the begin and the length, in planes, of the exposure of the given image, beyond the clip too."""
        return plane + 0.5 - self.planes / 2, self.planes

    def counts(self, first: int, last: int, part: Part = WHOLE) -> NDArray[np.float32]:
        """Return what the spikes' source counts."""
        return self.spikes.counts(first, last, part)

    def useless(self, last: int) -> NDArray[np.bool_]:
        """Return which pixels [H, W] are of no use to the spikes' source."""
        return self.spikes.useless(last)

    def recorded_mask(self, moving: Mask) -> Mask:
        """Return the recorded pixels [h, w] under a mask [H, W] of the spikes' source."""
        return self.spikes.recorded_mask(moving)

    def retargeted(self, moving: Mask, method_for: MethodFor) -> GivenSource:
        """Return the same images with other pixels `moving`."""
        return replace(self, moving=moving, spikes=self.spikes.retargeted(moving, method_for))


def shrunk(image: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Average an image down to the size of `camera`."""
    small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)
