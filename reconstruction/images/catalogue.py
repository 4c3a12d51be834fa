"""The sources of target images by the name an operator gives: methods that turn spikes into images, and given images.

A method is one file of `reconstruction.images.methods` that defines an `ImageMethod`; a new one takes that file and a
line in the README, and every list follows. Listing imports no torch.
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.members import members
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import Bytes, pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError

# The true light of an instant, its mean over a window, and what an ordinary camera reads of a longer exposure.
GIVEN = ("clean", "blurred", "ordinary")


@dataclass(frozen=True, eq=False)
class Estimate:
    """Linear intensity [H, W] float32 in spikes per tick, always finite; `valid` [H, W] where it is no mere bound.

    `sigma` [H, W] float32: one standard deviation of the intensity in spikes per tick under constant light, from the
    quantisation to whole spikes and ticks and from shot noise (`noise`); finite. It knows nothing of motion blur.
    """

    intensity: NDArray[np.float32]
    valid: NDArray[np.bool_]
    sigma: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Focus:
    """The only pixels [H, W] that an image is wanted of: a packed plane of them, and their places [K], row by row."""

    packed: Bytes
    places: NDArray[np.int64]

    @classmethod
    def on(cls, pixels: NDArray[np.bool_], layout: PlaneLayout) -> "Focus":
        """Return the focus on `pixels` [H, W] and their neighbours, which fill in for one that fails."""
        import cv2  # which listing the methods does without

        grown = cv2.dilate(pixels.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        return cls(pack(grown[None], layout)[0], np.flatnonzero(grown))

    def taken(self, image: NDArray) -> NDArray:
        """Return the values [..., K] of images [..., H, W]."""
        return image.reshape(*image.shape[:-2], -1).take(self.places, axis=-1)

    def spread(self, values: NDArray, shape: tuple[int, int]) -> NDArray:
        """Return an image [H, W] that has `values` [K] and is zero elsewhere."""
        image = np.zeros(shape, values.dtype)
        image.ravel()[self.places] = values
        return image


@dataclass(frozen=True)
class ImageMethod:
    """A way to turn spikes into an image: call it with a stream and the plane at which the image is wanted.

    `make` does the work. A `learned` one takes `weights=`, a file of the user's own; one that `focuses` takes
    `focus=`, the only pixels to look at. `price_s` is the processor time of one 400x250 picture in
    seconds, as `reconstruction.run.prices` measures it.
    """

    name: str
    make: Callable[..., Estimate]
    price_s: float
    learned: bool = False
    focuses: bool = False

    def __call__(self, stream: SpikeStream, plane: int) -> Estimate:
        """Return the image at `plane`; raises BadRecordingError for a plane outside the stream."""
        return self.make(stream, plane)


@functools.cache
def methods() -> Mapping[str, ImageMethod]:
    """Return every method by its name."""
    return members("reconstruction.images.methods", ImageMethod)


def names() -> tuple[str, ...]:
    """Return the names of the methods."""
    return tuple(methods())


def sources() -> tuple[str, ...]:
    """Return every name that target images can be asked for by: the methods, then the given images."""
    return (*names(), *GIVEN)


def price_s(source: str) -> float:
    """Return the processor seconds of one 400x250 picture from `source`; given images are only read."""
    return 0.0 if source in GIVEN else methods()[source].price_s


def method(name: str, weights: Path | None = None) -> ImageMethod:
    """Return the method `name`, a learned one with `weights` if given; raises BadRunError listing the known ones."""
    if name not in methods():
        raise BadRunError(f"found the image method {name!r}", f"one of {', '.join(names())}")
    found = methods()[name]
    if weights is None:
        return found
    if not found.learned:
        learned = ", ".join(m.name for m in methods().values() if m.learned)
        raise BadRunError(f"found weights for the method {name!r}", f"one of {learned} beside them")
    return replace(found, make=functools.partial(found.make, weights=weights))


def method_for(name: str, layout: PlaneLayout, pixels: NDArray[np.bool_]) -> ImageMethod:
    """Return `method(name)` for a caller who uses `pixels` [H, W] alone: faster where the method can focus on them."""
    found = method(name)
    if not found.focuses:
        return found
    return replace(found, make=functools.partial(found.make, focus=Focus.on(pixels, layout)))
