"""Finds edges of still things to sub-pixel, and the edge nearest to a place that faces the same way.

An edge tells where it is across itself alone. Letters: E places on edges, N places asked for.
Source: Canny, "A computational approach to edge detection", 1986; Devernay, "A non-maxima suppression method for edge
detection with sub-pixel accuracy", 1995.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.calibration.features import Image, toned
from rigs.transform import Floats

SMOOTH_PX = 1.0
LEAST_SLOPE = 0.01  # of the tone, a px
STRAIGHT_PX = 3.0  # deviation of the neighbourhood in which an edge has one direction
LEAST_STRAIGHT = 0.9  # coherence of the structure tensor: 1 where all slopes are parallel, 0 where they are not
BORDER_PX = 4
MOVER_PX = 4  # nearest to a mover; its blur moves edges
SECTORS = 12  # of the directions that edges face
TINY = np.float32(np.finfo(np.float32).tiny)
OVERLAP = np.radians(15.0)  # by which sectors reach into their neighbours


@dataclass(frozen=True, eq=False)
class Edges:
    """Places [E, 2] in px on the edges of an image, the unit normals [E, 2] towards the light, and the `slopes` [E].

    `shape` is the image's height and width.
    """

    places: Floats
    normals: Floats
    slopes: Floats
    shape: tuple[int, int]

    def __len__(self) -> int:
        return len(self.places)

    def only(self, kept: NDArray) -> Edges:
        """Return the edges at indices, or where a mask is true."""
        return Edges(self.places[kept], self.normals[kept], self.slopes[kept], self.shape)

    @cached_property
    def _nearest(self) -> NDArray[np.int64]:
        """For every sector and pixel [SECTORS, H, W], which edge that faces that way is nearest; -1 without any."""
        angle = np.arctan2(self.normals[:, 1], self.normals[:, 0])
        found = np.full((SECTORS, *self.shape), -1, dtype=np.int64)
        for sector in range(SECTORS):
            off = np.abs(np.angle(np.exp(1j * (angle - sector * 2 * np.pi / SECTORS))))
            own = np.flatnonzero(off < np.pi / SECTORS + OVERLAP)
            if not len(own):
                continue
            column, row = np.floor(self.places[own]).astype(np.int64).T
            apart = np.full(self.shape, 255, np.uint8)
            apart[row, column] = 0
            label = cv2.distanceTransformWithLabels(apart, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)[1]
            label = label.astype(np.int64)
            edge = np.zeros(int(label.max()) + 1, dtype=np.int64)
            edge[label[row, column]] = own
            found[sector] = edge[label]
        return found

    def nearest(self, places: Floats, normals: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Return the edges [N] nearest to places [N, 2] in px that face alike, and how far [N] off they are.

        Where there is none, or the place is outside the picture, the distance is infinite.
        """
        turn = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi / SECTORS)
        sector = np.round(turn).astype(np.int64) % SECTORS
        height, width = self.shape
        inside = np.all((places >= 0) & (places < (width, height)), axis=1)  # false for NaN
        column, row = np.floor(np.where(inside[:, None], places, 0)).astype(np.int64).T
        edge = np.where(inside, self._nearest[sector, row, column], -1)
        if not len(self):
            return edge, np.full(len(places), np.inf)
        return edge, np.where(edge >= 0, np.linalg.norm(self.places[edge] - places, axis=1), np.inf)


def find_edges(image: Image, moving: NDArray[np.bool_] | None = None) -> Edges:
    """Find the edges of an image [H, W] in spikes per tick, away from pixels that are `moving` [H, W]."""
    tone = cv2.GaussianBlur(toned(image), (0, 0), SMOOTH_PX)
    dx, dy = (np.asarray(cv2.Sobel(tone, cv2.CV_32F, d, 1 - d, scale=1 / 8), np.float32) for d in (1, 0))
    slope = np.hypot(dx, dy)
    normal = np.asarray(np.stack([dx, dy]) / np.maximum(slope, TINY), np.float32)
    behind, ahead = _beside(slope, -normal), _beside(slope, normal)
    kept = np.asarray(
        (slope > behind) & (slope >= ahead) & (slope > LEAST_SLOPE) & (_straightness(dx, dy) > LEAST_STRAIGHT)
    )
    if moving is not None:
        kept &= ~cv2.dilate(moving.astype(np.uint8), np.ones((2 * MOVER_PX + 1, 2 * MOVER_PX + 1))).astype(np.bool_)
    inner = np.zeros(slope.shape, np.bool_)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    row, column = np.nonzero(kept & inner)
    before, here, after = behind[row, column], slope[row, column], ahead[row, column]
    ridge = 0.5 * (before - after) / np.minimum(before - 2 * here + after, -TINY)  # of a parabola
    normals = normal[:, row, column].T.astype(np.float64)
    places = np.stack([column, row], axis=1) + 0.5 + np.clip(ridge, -0.6, 0.6)[:, None] * normals
    return Edges(places, normals, here.astype(np.float64), slope.shape)


def _beside(image: Image, steps: NDArray[np.float32]) -> Image:
    """Sample an image [H, W] at steps [2, H, W] in px off each pixel."""
    row, column = np.indices(image.shape, dtype=np.float32)
    return np.asarray(cv2.remap(image, column + steps[0], row + steps[1], cv2.INTER_CUBIC), np.float32)


def _straightness(dx: Image, dy: Image) -> Image:
    """Return the coherence [H, W] of the structure tensor of slopes."""
    xx, xy, yy = (cv2.GaussianBlur(part, (0, 0), STRAIGHT_PX) for part in (dx * dx, dx * dy, dy * dy))
    whole = np.maximum(xx + yy, TINY)
    return np.asarray(np.hypot(xx - yy, 2 * xy) / whole, np.float32)
