"""Points that training can start from in place of our sweep's: an initialiser's, or some at random depths.

They answer how much points are worth, so both are brought to as many as the sweep has. Letters: N points.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import StereoError
from reconstruction.images.composite import CompositeSource
from reconstruction.initialization.geometry import Geometry
from reconstruction.initialization.points import Points, sample_points, spacing
from reconstruction.initialization.sweep import DepthMap, depth_range_m
from reconstruction.pipeline import artefacts
from reconstruction.run.configuration import FOUND, RANDOM
from reconstruction.run.decisions import Decision
from reconstruction.run.folder import RunFolder
from rigs.camera import Camera

NEAR = 0.5  # standard deviation, in gaps to the neighbours, of an added point around the one it is added to
Views = Mapping[str, tuple[Camera, CompositeSource]]
Image = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Found:
    """Points of an initialiser: positions [N, 3] in m, and the plane they were seen at [1]; [0] without one."""

    positions: NDArray[np.float64]
    planes: NDArray[np.int64]

    @classmethod
    def of(cls, geometry: Geometry) -> Found:
        """Return the points of a geometry."""
        planes = [] if geometry.plane is None else [geometry.plane]
        return cls(geometry.points, np.array(planes, np.int64))


class OtherPoints(Protocol):
    """Points of the views of a run that no sweep has found."""

    def still(self, views: Views, count: int) -> Points:
        """Return at most `count` points of still things; raises StereoError where there are none."""
        ...

    def movers(self, views: Views, at: tuple[int, float], count: int) -> Points | None:
        """Return at most `count` points of movers `at` a plane and its instant in seconds; None: they are swept."""
        ...


def other_points(run: RunFolder, rng: np.random.Generator) -> OtherPoints | None:
    """Return the points that the plan of a run wants; None for those of the sweep."""
    if run.plan.points == FOUND:
        return FoundPoints(artefacts.read(run, artefacts.FOUND_POINTS, Found), rng)
    return RandomPoints(rng) if run.plan.points == RANDOM else None


def leave_unswept(run: RunFolder, views: Views) -> None:
    """Write what a sweep tells beside points as not known: depths of views, and gains of cameras."""
    for view, (camera, _) in views.items():
        unknown = np.full((camera.height, camera.width), np.nan, np.float32)
        run.write_array(artefacts.DEPTH.format(view=view), unknown)
    run.write_array(artefacts.GAINS, np.ones(len(views)))
    run.amend("points", Decision("gains", "taken as alike", "the sweep that tells them was left out", "--points"))


@dataclass(frozen=True, eq=False)
class RandomPoints:
    """Points behind random pixels of the training views, as even in inverse depth as a sweep's hypotheses."""

    rng: np.random.Generator

    def still(self, views: Views, count: int) -> Points:
        """Return points behind pixels whose background is known."""
        images = [source.background.image for _, source in views.values()]
        known = [source.background.trusted for _, source in views.values()]
        return sample_points(self._maps(views), images, known, count, 0.0, self.rng)

    def movers(self, views: Views, at: tuple[int, float], count: int) -> Points:
        """Return points behind pixels that see a mover."""
        plane, instant_s = at
        images = [source.at(plane) for _, source in views.values()]
        moving = [source.movers(image, plane) for image, (_, source) in zip(images, views.values(), strict=True)]
        return sample_points(self._maps(views), images, moving, count, instant_s, self.rng)

    def _maps(self, views: Views) -> list[DepthMap]:
        near_m, far_m = depth_range_m([camera for camera, _ in views.values()])
        maps = []
        for camera, _ in views.values():
            depth = 1 / self.rng.uniform(1 / far_m, 1 / near_m, (camera.height, camera.width))
            maps.append(DepthMap(camera, depth.astype(np.float32), np.zeros(depth.shape, np.float32)))
        return maps


@dataclass(frozen=True, eq=False)
class FoundPoints:
    """The points of an initialiser, with the light that the views see in their direction.

    Fewer than are wanted are filled up by others close to them.
    """

    found: Found
    rng: np.random.Generator

    def still(self, views: Views, count: int) -> Points:
        """Return the points that no view sees move."""
        still = ~self._moving(views)
        images = {view: source.background.image for view, (_, source) in views.items()}
        light = self._light(views, images)
        return self._taken(still & np.isfinite(light), light, count, 0.0)

    def movers(self, views: Views, at: tuple[int, float], count: int) -> Points | None:
        """Return the points that most views see move, where they were seen at that plane; else they are swept."""
        plane, instant_s = at
        if plane not in self.found.planes:
            return None
        light = self._light(views, {view: source.at(plane) for view, (_, source) in views.items()})
        moving = self._moving(views) & np.isfinite(light)
        return self._taken(moving, light, count, instant_s) if moving.any() else Points.none()

    def _moving(self, views: Views) -> NDArray[np.bool_]:
        """Return which points [N] most of the views that have them in the picture see as movers."""
        votes = np.zeros((2, len(self.found.positions)), np.int64)
        for plane in self.found.planes:
            for camera, source in views.values():
                seen, at = _places(camera, self.found.positions)
                votes[0, seen] += 1
                votes[1, seen] += source.movers(source.at(int(plane)), int(plane))[at]
        return 2 * votes[1] > votes[0]

    def _light(self, views: Views, images: Mapping[str, Image]) -> Image:
        """Return the median light [N] of the views that have a point in the picture; NaN where none has."""
        light = np.full((len(views), len(self.found.positions)), np.nan, np.float32)
        for row, (view, (camera, _)) in zip(light, views.items(), strict=True):
            seen, at = _places(camera, self.found.positions)
            row[seen] = images[view][at]
        unseen = np.isnan(light).all(axis=0)
        light[:, unseen] = 0
        return np.where(unseen, np.float32(np.nan), np.nanmedian(light, axis=0))

    def _taken(self, which: NDArray[np.bool_], light: Image, count: int, instant_s: float) -> Points:
        """Return `count` points: a random part of those at `which` [N], or all and as many more around them."""
        own = self.rng.permutation(np.flatnonzero(which))[:count]
        if not len(own):
            raise StereoError("found no point in the views", "points of the initialiser", "take --points swept")
        more = self.rng.choice(own, count - len(own))
        positions, gaps = self.found.positions[own], np.zeros(len(self.found.positions))
        gaps[own] = spacing(positions)
        around = self.rng.normal(scale=NEAR, size=(len(more), 3)) * gaps[more, None]
        positions = np.concatenate([positions, self.found.positions[more] + around])
        shown = light[np.concatenate([own, more])]
        return Points(positions, shown, spacing(positions), np.full(len(positions), instant_s))


def _places(camera: Camera, points: NDArray[np.float64]) -> tuple[NDArray[np.int64], tuple[NDArray, NDArray]]:
    """Return which points [k] of [N, 3] a camera has in its picture, and the rows and columns of their pixels."""
    pixels, inside = camera.project(points)
    seen = np.flatnonzero(inside)
    columns, rows = pixels[seen].astype(np.int64).T
    return seen, (rows, columns)
