"""Straightens target images and counts to the pinhole view of a camera, once from the recorded pixels.

Here the pipeline goes over from recorded pictures to those it works in (`reconstruction.lenses`). Whatever looks at
spikes pixel by pixel (image methods, movers, stuck pixels) looks at the recorded ones; its result is straightened.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import Background
from reconstruction.images.composite import CompositeSource, Mask, MethodFor
from reconstruction.images.mending import mended, nearest_good
from reconstruction.lenses.resampling import WHOLE, Part
from reconstruction.lenses.straight import Straightening

Image = NDArray[np.float32]
MOSTLY = 0.5  # least share of a pixel's light from where one surface is seen most of the time


class StraightStream(SpikeStream):
    """The spikes of a camera, counted over the pixels of its view.

    `planes`, `window` and `window_counts` are of the recorded pixels.
    """

    def __init__(self, recorded: SpikeStream, straightening: Straightening, stuck: Mask):
        super().__init__(recorded.packed, recorded.layout, recorded.tick_rate_hz, recorded.partial_bytes)
        self.straightening, self.stuck = straightening, stuck

    def part(self, first: int, last: int) -> StraightStream:
        """Return planes [first, last) as a stream of their own."""
        return StraightStream(super().part(first, last), self.straightening, self.stuck)

    def counts(self, first: int, last: int) -> Image:  # type: ignore[override]
        """Return what whole pixels would have counted over planes [first, last) [H, W], stuck ones mended first."""
        return self.straightening.light(mended(super().counts(first, last).astype(np.float32), self.stuck))


@dataclass(frozen=True, eq=False)
class StraightSource(CompositeSource):
    """One camera's target images as its view has them: those of the `recorded` source, straightened.

    Pixels of the view that the camera does not wholly cover hold what is next to them, and count as stuck.
    """

    recorded: CompositeSource = field(kw_only=True)

    def _made(self, plane: int) -> Image:
        image = self.recorded.at(plane)
        self.recorded.kept.clear()  # what is kept is kept here
        return self._way.light(image, self.moving)

    @property
    def _way(self) -> Straightening:
        assert self.straightening is not None
        return self.straightening

    def counts(self, first: int, last: int, part: Part = WHOLE) -> Image:
        """Return the light [H, W] that a part of the view gathered over planes [first, last), in spikes."""
        return self._way.light(mended(self.recorded.counts(first, last), self.recorded.useless(last)), part)

    def useless(self, last: int) -> Mask:
        """Return which pixels [H, W] of the view are of no use in planes before `last`."""
        if self.recorded.response is None:
            return self.background.stuck
        return self.background.stuck | self._way.touched(self.recorded.useless(last))

    def dimmed(self, gain: float) -> StraightSource:
        """Return the images of a camera that sees `gain` times the light, with that taken out of images and counts."""
        return self if gain == 1 else straightened(self.recorded.dimmed(gain), self._way)

    def part(self, first: int, last: int) -> StraightSource:
        """Return the images of planes [first, last) as a source of their own, with the same background."""
        return straightened(self.recorded.part(first, last), self._way)

    def carried(self, image: Image) -> Image:
        """Return a recorded image [h, w] as the view has it [H, W]."""
        return _filled(self._way.light(image), self._way.covered)

    def carried_mask(self, pixels: Mask) -> Mask:
        """Return the pixels [H, W] of the view that a mask of recorded ones [h, w] touches."""
        return self._way.covered & self._way.touched(pixels)

    def recorded_mask(self, moving: Mask) -> Mask:
        """Return the recorded pixels [h, w] under a mask [H, W] of the view."""
        return self._way.touching(moving)

    def retargeted(self, moving: Mask, method_for: MethodFor) -> StraightSource:
        """Return the same source with other pixels `moving`, imaged by what `method_for` makes of stream and pixels."""
        recorded = self.recorded.retargeted(self.recorded_mask(moving), method_for)
        return replace(self, moving=moving, recorded=recorded, kept={})


def straightened(recorded: CompositeSource, way: Straightening) -> StraightSource:
    """Return a source of recorded images as one of the view's."""
    still = recorded.background
    background = Background(
        _filled(way.light(still.image), way.covered),
        way.covered & ~way.touched(~still.trusted, MOSTLY),
        ~way.covered | way.touched(still.stuck),
    )
    own = {f.name: getattr(recorded, f.name) for f in fields(CompositeSource)}
    own |= {"stream": StraightStream(recorded.stream, way, still.stuck), "background": background, "kept": {}}
    own |= {"moving": way.covered & way.touched(recorded.moving), "straightening": way}
    return StraightSource(**own, recorded=recorded)


def _filled(image: Image, known: Mask) -> Image:
    """Return an image [H, W] whose pixels that are not `known` have the value of the nearest one that is."""
    return image if known.all() or not known.any() else image.ravel()[nearest_good(~known)]
