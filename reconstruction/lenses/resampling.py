"""Reads pictures between their pixels by Lanczos's kernel, which keeps detail that means over pixels would blur.

Weights of a place sum to one. Beyond the edge a picture goes on as its edge. Where neighbouring places lie further
apart than SPARSE pixels, a place stands for the mean of several. Cost: 72 multiplications a place.
Source: Duchon, "Lanczos filtering in one and two dimensions", J. Applied Meteorology 1979.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.native import Address
from reconstruction.native import Long, kernel
from rigs.transform import Floats

REACH = 4  # pixels on either side, which the kernel knows
SPARSE = 2.0  # pixels between neighbouring places above which each stands for several
Image = NDArray[np.float32]
Part = slice | tuple[slice, slice] | NDArray[np.bool_]
WHOLE: Part = np.s_[:, :]

_read_between = kernel("read_between", Address, Long, Address, Address, Address, Address, Long, Address)


@dataclass(frozen=True, eq=False)
class Reading:
    """Places [H, W] that read a picture: the first of the 2 REACH pixels of each, and their weights [H, W, 2 REACH]."""

    size: tuple[int, int]  # h, w of the picture
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    down: Image
    across: Image

    @classmethod
    def at(cls, places: Floats, size: tuple[int, int]) -> Reading:
        """Return how `places` [H, W, 2] (x, y in px, the first pixel's centre at 0.5) read a picture of size (h, w)."""
        height, width = size
        inside = np.clip(np.nan_to_num(places, nan=-1.0), 0, (width, height)) - 0.5
        first = np.floor(inside).astype(np.int64)
        apart = (inside - first)[..., None, :] - np.arange(1 - REACH, REACH + 1)[:, None]  # [H, W, 2 REACH, 2]
        weights = np.sinc(apart) * np.sinc(apart / REACH)
        weights = (weights / weights.sum(axis=-2, keepdims=True)).astype(np.float32)
        down, across = (np.ascontiguousarray(weights[..., axis]) for axis in (1, 0))
        return cls(size, first[..., 1] + 1, first[..., 0] + 1, down, across)

    def __call__(self, picture: Image, part: Part = WHOLE) -> Image:
        """Return the values of `picture` [h, w] at the places, or at a part of them."""
        if picture.shape != self.size:  # which the kernel could not tell
            raise ValueError(f"found a picture of {picture.shape}, expected {self.size}")
        padded = np.pad(picture.astype(np.float32, copy=False), REACH, mode="edge")
        chosen = self._numbers[part]
        values = np.zeros(chosen.shape, np.float32)
        places = np.ascontiguousarray(chosen), chosen.size
        _read_between(padded, padded.shape[1], self._start, self.down, self.across, *places, values)
        return values

    @property
    def squared(self) -> Reading:
        """The same places with the squares of their weights."""
        return replace(self, down=self.down**2, across=self.across**2)

    @functools.cached_property
    def _numbers(self) -> NDArray[np.int64]:
        """The numbers [H, W] of the places, row by row."""
        return np.arange(self.row.size).reshape(self.row.shape)

    @functools.cached_property
    def _start(self) -> NDArray[np.int64]:
        """The first pixel [H, W] of each place in the padded picture."""
        return self.row * (self.size[1] + 2 * REACH) + self.column

    @property
    def nearest(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The row and the column [H, W] of the pixel that each place lies in."""
        ends = ((self.row, self.down, self.size[0]), (self.column, self.across, self.size[1]))
        middle = np.s_[..., REACH - 1 : REACH + 1]
        row, column = (np.clip(first - 1 + w[middle].argmax(axis=-1), 0, n - 1) for first, w, n in ends)
        return row, column

    def spread(self, values: Floats) -> Floats:
        """Return what each pixel of a picture [h, w] gives in all, where places have use for `values` [H, W] of it."""
        stride = self.size[1] + 2 * REACH
        total = np.zeros((self.size[0] + 2 * REACH) * stride)
        for i, j in np.ndindex(2 * REACH, 2 * REACH):
            given = values * self.down[..., i] * self.across[..., j]
            total += np.bincount((self._start + (i * stride + j)).ravel(), given.ravel(), len(total))
        padded = total.reshape(-1, stride)
        for axis in (0, 1):  # beyond the edge it was the edge that was read
            padded = np.moveaxis(padded, axis, 0)
            padded[REACH] += padded[:REACH].sum(axis=0)
            padded[-REACH - 1] += padded[-REACH:].sum(axis=0)
            padded = np.moveaxis(padded[REACH:-REACH], 0, axis)
        return padded


def readings(places_of: Callable[[Floats], Floats], shape: tuple[int, int], size: tuple[int, int]) -> list[Reading]:
    """Return the readings of a picture of size (h, w) whose mean is that of pixels [H, W] elsewhere.

    `places_of` tells where places [N, 2] of the pixels lie in the picture.
    """
    rows, columns = np.indices(shape, dtype=np.float64)
    corner = np.stack([columns, rows], axis=-1)

    def placed(offset: Sequence[float]) -> Floats:
        return places_of((corner + offset).reshape(-1, 2)).reshape(*shape, 2)

    middle = placed((0.5, 0.5))
    inside = np.asarray(np.logical_and(middle > 0, middle < (size[1], size[0])).all(axis=-1))
    apart = [np.linalg.norm(np.diff(middle, axis=axis), axis=-1) for axis in (0, 1)]
    both = np.logical_and(inside[1:], inside[:-1]), np.logical_and(inside[:, 1:], inside[:, :-1])
    widest = max(float(gap[seen].max(initial=0.0)) for gap, seen in zip(apart, both, strict=True))
    count = max(1, math.ceil(widest / SPARSE))
    steps = (np.arange(count) + 0.5) / count
    return [Reading.at(placed((x, y)), size) for y in steps for x in steps]
