"""Goes between the picture of a lens that bends and that of a pinhole that covers it, with no charge lost.

The view of a camera is the pinhole at its place with its focal lengths, so at the centre a pixel stays a pixel, and
with so many pixels more that everything the camera sees lies inside. Letters: P pixels of the camera with the values d,
Q pixels of the view.

- Each pixel of the camera covers a quadrilateral of the view. By the areas that these have in a pixel of the view, it
  holds J pixels of the camera. (Sides are straight: at 400 pixels and a bend of 10% that errs by 1e-4 px.)
- L [Q, P] reads the camera's picture at the middles of the view's pixels (`resampling`); its rows sum to one.
- S = J L / c with c = J L summed over Q: the share of each pixel's charge that goes to each pixel of the view. Its
  columns sum to one, so charge S d is that of d. c is one to 1.5%, and to 10% at the edge.
- Light is (S d) / (S 1): even light stays even. S 1 (`exposure`) times it is the charge again.
- Noise of that light, for pixels that err by s each: sqrt(S^2 s^2) / (S 1).

Means over areas alone (S from the quadrilaterals) also keep charge, and blur: they cost 4 dB where these cost none.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reconstruction.lenses.resampling import WHOLE, Part, Reading, readings
from rigs.camera import Camera
from rigs.errors import RigError
from rigs.lens import Lens
from rigs.rig import Rig
from rigs.transform import Floats, Transform

MOST_PIXELS = 6.0  # pixels of a view for each of the camera; a lens that needs more sees too far off its axis
LEAST_PIXELS = 0.25  # of the same; a lens that needs fewer is no lens
LEAST_AREA = 1e-9  # px^2 of an overlap; less is rounding
COVERED = 0.999  # share of a view's pixel that pixels of the camera must cover
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Straightening:
    """The way between a camera of [h, w] pixels and its view of [H, W].

    `pixels` [K, H, W] are the K pixels of the camera, row by row, that give a pixel of the view most, and `areas`
    [K, H, W] of them the share that lies in it; places without one have the share 0. `covered` [H, W]: wholly seen by
    the camera. `forth` read the camera's picture, `back` the view's.
    """

    size: tuple[int, int]  # h, w
    pixels: NDArray[np.int32]
    areas: Image
    covered: Mask
    forth: tuple[Reading, ...]
    back: tuple[Reading, ...]

    @functools.cached_property
    def _density(self) -> Image:
        """J: the pixels of the camera [H, W] in each of the view."""
        return self.areas.sum(axis=0)

    @functools.cached_property
    def _even(self) -> tuple[Image, Image]:
        """1 / c [h, w], and what the view reads of it [H, W]."""
        weights = self._density / np.float64(len(self.forth))
        given = np.sum([reading.spread(weights) for reading in self.forth], axis=0)
        inverse = (1 / given).astype(np.float32)
        return inverse, self._read(inverse, WHOLE)

    @functools.cached_property
    def exposure(self) -> Image:
        """S 1: the charge [H, W] that reaches a pixel of the view where each of the camera has one unit."""
        return self._density * self._even[1]

    @functools.cached_property
    def noise(self) -> Image:
        """The deviation [H, W] of straightened light where the camera's pixels err by one each; 1 where not covered.

        Off by up to a third within `resampling.REACH` pixels of the edge, which stands in for what lies beyond.
        """
        inverse, even = self._even
        variance = np.mean([reading.squared(inverse * inverse) for reading in self.forth], axis=0)
        found = np.sqrt(np.maximum(variance, 0)) / even
        return np.where(self.covered, found, 1).astype(np.float32)

    def charge(self, counts: NDArray) -> Image:
        """Return the charge [H, W] of counts [h, w]: S d."""
        return self._density * self._read(counts * self._even[0], WHOLE)

    def light(self, image: NDArray, part: Part = WHOLE) -> Image:
        """Return the light [H, W] of an image [h, w], or that of a part of the view; what is not covered is a guess."""
        inverse, even = self._even
        return self._read(image * inverse, part) / even[part]

    def touched(self, mask: Mask, least: float = 0.02) -> Mask:
        """Return the pixels [H, W] of the view of which a `mask` [h, w] covers more than a share."""
        covered = (self.areas * mask.ravel()[self.pixels]).sum(axis=0)
        return covered > least * self._density

    def touching(self, mask: Mask, least: float = 0.02) -> Mask:
        """Return the pixels [h, w] of which more than a share lies under a `mask` [H, W] of the view."""
        under = np.bincount(self.pixels.ravel(), (self.areas * mask).ravel(), self.size[0] * self.size[1])
        return under.reshape(self.size) > least

    def bent(self, image: Image) -> Image:
        """Return the light of a picture [H, W] of the view as the camera has it [h, w]."""
        light = np.mean([reading(image) for reading in self.back], axis=0, dtype=np.float32)
        return np.asarray(np.maximum(light, 0), np.float32)

    def nearest(self, image: NDArray) -> NDArray:
        """Return what the middles of the camera's pixels [h, w] see of a picture [H, W] of the view: for depths."""
        return image[self.back[len(self.back) // 2].nearest]

    def _read(self, image: NDArray, part: Part) -> Image:
        return np.asarray(np.mean([reading(image, part) for reading in self.forth], axis=0), np.float32)


def view_of(camera: Camera, size: tuple[int, int] | None = None) -> Camera:
    """Return the pinhole that covers the picture of `camera`, of that size (width, height) where one is given.

    Raises RigError where its lens folds inside the picture, sees so far off its axis that no pinhole takes it, or so
    narrowly that a pinhole loses detail.
    """
    if not camera.bends and size in (None, (camera.width, camera.height)):
        return camera
    places = _corners(Optics.of(camera))
    if not np.isfinite(places).all():
        degrees = math.degrees(math.atan(camera.lens.steepest))
        found = f"found a lens that folds {degrees:.1f} degrees off its axis, inside the picture"
        raise RigError(found, "one picture for each ray", "calibrate it again", where=camera.id)
    low, high = np.floor(places.min(axis=(0, 1)) + 1e-9), np.ceil(places.max(axis=(0, 1)) - 1e-9)
    width, height = (high - low).astype(np.int64).tolist()
    if (width - 2) * (height - 2) > MOST_PIXELS * camera.width * camera.height:  # but for what rounding adds
        slopes = (places - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        degrees = math.degrees(math.atan(float(np.linalg.norm(slopes, axis=2).max())))
        found = f"found a lens that sees {degrees:.0f} degrees off its axis: {width}x{height} pixels of a pinhole"
        expected = f"at most {MOST_PIXELS:g} times its {camera.width}x{camera.height}"
        raise RigError(found, expected, "record a part of its picture", where=camera.id)
    if width * height < LEAST_PIXELS * camera.width * camera.height:
        found = f"found a lens whose picture is {width}x{height} pixels of a pinhole"
        expected = f"at least {LEAST_PIXELS:g} times its {camera.width}x{camera.height}"
        raise RigError(found, expected, "calibrate it again", where=camera.id)
    wide, tall = size or (width, height)
    left, top = int(low[0]) - (wide - width) // 2, int(low[1]) - (tall - height) // 2
    middle = {"cx": camera.cx - left, "cy": camera.cy - top}
    return replace(camera.pinhole(), width=wide, height=tall, pixels=None, **middle)


def views_of(rig: Rig, ids: Iterable[str]) -> Mapping[str, Camera]:
    """Return the views of the cameras `ids`, all of one size where any lens bends; else the cameras themselves."""
    cameras = {camera_id: rig.camera(camera_id) for camera_id in ids}
    if not any(camera.bends for camera in cameras.values()):
        return cameras
    alone = [view_of(camera) for camera in cameras.values()]
    size = max(view.width for view in alone), max(view.height for view in alone)
    return {camera_id: view_of(camera, size) for camera_id, camera in cameras.items()}


def straightening(camera: Camera, view: Camera) -> Straightening:
    """Return the way between a camera and its view; cameras with the same lens and size share it."""
    corner = round(camera.cx - view.cx), round(camera.cy - view.cy)
    return _straightening(Optics.of(camera), corner, (view.width, view.height))


class Optics(NamedTuple):
    """All of a camera that does not depend on its place."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    lens: Lens

    @classmethod
    def of(cls, camera: Camera) -> Optics:
        """Return the optics of a camera."""
        return cls(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.lens)

    @property
    def camera(self) -> Camera:
        """A camera with these optics."""
        lens = {"distortion": self.lens.coefficients, "lens_model": self.lens.model}
        return Camera("one", *self[:6], Transform.identity(), **lens)


@functools.lru_cache(maxsize=32)
def _straightening(optics: Optics, corner: tuple[int, int], size: tuple[int, int]) -> Straightening:
    """Return the way to the view of that size whose first pixel lies at `corner` of the pinhole's plane."""
    camera, shape = optics.camera, (size[1], size[0])
    corners = _corners(optics) - corner
    quads = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]], axis=2)
    giver, taker, area = overlaps(quads.reshape(-1, 4, 2), size[0])
    whole = np.bincount(giver, area, camera.width * camera.height)
    covered = np.bincount(taker, area, size[0] * size[1]) >= COVERED
    order = np.lexsort((-area, taker))
    giver, taker, share = giver[order], taker[order], (area / whole[giver])[order]
    slot = np.arange(len(taker)) - np.searchsorted(taker, np.arange(size[0] * size[1]))[taker]
    slots = (int(slot.max()) + 1, size[0] * size[1])
    pixels, shares = np.zeros(slots, np.int32), np.zeros(slots, np.float32)
    pixels[slot, taker], shares[slot, taker] = giver, share
    forth = readings(lambda places: camera.bent(places + corner), shape, (camera.height, camera.width))
    back = readings(lambda places: camera.straightened(places) - corner, (camera.height, camera.width), shape)
    parts = pixels.reshape(-1, *shape), shares.reshape(-1, *shape), covered.reshape(shape)
    return Straightening((camera.height, camera.width), *parts, tuple(forth), tuple(back))


def overlaps(quads: Floats, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Return which quadrilaterals [N, 4, 2] overlap which pixels of a grid `width` wide, and by what area, in pixels.

    Three arrays of one length: the quadrilateral, the pixel by rows, the area. Corners run from x to y.
    """
    low, high = np.floor(quads.min(axis=1)).astype(np.int64), np.ceil(quads.max(axis=1)).astype(np.int64)
    spans, kinds = np.unique(np.maximum(high - low, 1), axis=0, return_inverse=True)
    found = []
    for kind, (across, down) in enumerate(spans.tolist()):
        own = np.flatnonzero(kinds.ravel() == kind)
        areas = _areas(quads[own] - low[own, None], across, down)
        for row, column in np.ndindex(down, across):
            taker = (low[own, 1] + row) * width + low[own, 0] + column
            found.append((own, taker, areas[row, column]))
    giver, taker, area = (np.concatenate(parts) for parts in zip(*found, strict=True))
    some = area > LEAST_AREA
    return giver[some], taker[some], area[some]


def _areas(quads: Floats, across: int, down: int) -> Floats:
    """Return the areas [down, across, N] of quadrilaterals [N, 4, 2] in each pixel of a grid that holds them all."""
    below = np.zeros((down + 1, across + 1, len(quads)))  # the area left of and above a corner of the grid
    for one, other in zip(np.moveaxis(quads, 1, 0), np.roll(np.moveaxis(quads, 1, 0), -1, axis=0), strict=True):
        (x0, y0), (x1, y1) = one.T, other.T
        steep = (y1 - y0) / np.where(x1 == x0, 1.0, x1 - x0)
        for column in range(1, across + 1):
            left, right = np.minimum(x0, column), np.minimum(x1, column)
            upper, lower = y0 + (left - x0) * steep, y0 + (right - x0) * steep
            for row in range(1, down + 1):
                below[row, column] += (right - left) * _mean_above(row - upper, row - lower)
    return np.diff(np.diff(below, axis=0), axis=1)


def _mean_above(start: Floats, end: Floats) -> Floats:
    """Return the mean of the positive part of values that go evenly from `start` [N] to `end` [N]."""
    high, low = np.maximum(start, end), np.minimum(start, end)
    crossing = high * high / (2 * np.where(high > low, high - low, 1.0))
    return np.where(low >= 0, (high + low) / 2, np.where(high <= 0, 0.0, crossing))


@functools.lru_cache(maxsize=32)
def _corners(optics: Optics) -> Floats:
    """Return where the pinhole sees the corners of a camera's pixels [h + 1, w + 1, 2], in its own pixels."""
    shape = optics.height + 1, optics.width + 1
    rows, columns = np.indices(shape, dtype=np.float64)
    return optics.camera.straightened(np.stack([columns.ravel(), rows.ravel()], axis=1)).reshape(*shape, 2)
