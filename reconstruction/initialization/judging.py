"""Judges rigid bodies by spikes that they were not made from: counts between the instants that movers were swept at.

A body is kept where points that ride on it explain the counts about as well as the same points at rest, each of which
is seen around its own instant. What bends, turns too far between two instants or only changes its light does not.
Letters: K bodies, n points.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.images.composite import CompositeSource
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points, Seeds
from reconstruction.initialization.seeding import seed_cloud, seed_rigid
from rigs.camera import Camera
from rigs.clock import RigClock

WINDOW = 9  # planes of a count
LEAST_SPIKES = 4.0  # of a square, where single pixels have less than one
WIDEST_PX = 15
VIEWS = 4  # most views that judge
WORSE = 1.01  # error of points on a body, over that of points at rest, up to which the body is kept
AROUND = np.ones((3, 3), np.uint8)  # pixels around a point that are its own

Mask = NDArray[np.bool_]
Image = NDArray[np.float32]
View = tuple[Camera, CompositeSource]


@dataclass(frozen=True, eq=False)
class Judgement:
    """Errors [K] of counts in the pixels of each body, summed up in spikes: of points on it and of points at rest."""

    riding: NDArray[np.float64]
    resting: NDArray[np.float64]

    @property
    def kept(self) -> NDArray[np.int64]:
        """The numbers of the bodies that explain the counts; one that no view sees is not in doubt."""
        return np.flatnonzero(self.riding <= WORSE * self.resting)

    @property
    def ratio(self) -> float:
        """The error on the bodies that are kept over that of the same points at rest; 1 where none is."""
        resting = float(self.resting[self.kept].sum())
        return float(self.riding[self.kept].sum()) / resting if resting else 1.0


def judge(seeds: Seeds, views: Sequence[View], clock: RigClock, still: GaussianCloud | None = None) -> Judgement:
    """Return how well each of the bodies of `seeds` explains what the training cameras counted.

    `still` is the still scene, where it is more than points. Both models are seen in the light that the views saw.
    """
    bodies, starts = seeds.bodies(), [seed_rigid(seeds), seed_cloud(seeds)]
    clouds = starts if still is None else [replace(start, still=still) for start in starts]
    if views and views[0][1].light.flickers:
        clouds = [replace(cloud, light=torch.from_numpy(views[0][1].light.gains)) for cloud in clouds]
    sums = np.zeros((2, len(bodies)))
    sees = [view for view in views if view[1].moving.any()]
    for camera, source in sees[:: max(1, -(-len(sees) // VIEWS))] if len(bodies) else ():
        for i, between_s in enumerate(between(bodies.instants_s.tolist())):
            first = min(max(0, clock.plane(between_s) - WINDOW // 2), len(source.stream) - 1)
            last = min(len(source.stream), first + WINDOW)
            at_s, moving = clock.instant_s((first + last - 1) / 2), source.moving & ~source.useless(last)
            gaps = [_gap(cloud.look(camera, at_s).intensity, source, (first, last), moving) for cloud in clouds]
            own = [mask & moving for mask in _shown(clouds[0], bodies, seeds.moving, camera, (i, at_s))]
            sums += [[float(gap[mask].sum()) for mask in own] for gap in gaps]
    return Judgement(*sums)


def _gap(light: Image, source: CompositeSource, planes: tuple[int, int], moving: Mask) -> Image:
    """Return how far counts over `planes` are from the `light` [H, W] of a model where pixels move, in spikes."""
    counts, planes_count = source.counts(*planes), planes[1] - planes[0]
    gap = np.where(moving, counts - light * planes_count, 0).astype(np.float32)
    side = square_px(float(counts[moving].mean())) if moving.any() else 1
    return np.abs(gap if side == 1 else cv2.blur(gap, (side, side), borderType=cv2.BORDER_CONSTANT))


def _shown(riding: DynamicCloud, bodies: Bodies, points: Points, camera: Camera, at: tuple[int, float]) -> list[Mask]:
    """Return the pixels [H, W] of each body: where it would be `at` an instant, and where it was before and after."""
    number, at_s = at
    assert isinstance(riding.motion, RigidMotion)
    now, owners = riding.movers(at_s)[0].detach().double().numpy(), riding.motion.bodies.numpy()
    near = np.isin(points.instants_s, bodies.instants_s[number : number + 2])
    masks = []
    for k in range(len(bodies)):
        places = np.concatenate([now[: len(owners)][owners == k], points.positions[near & (bodies.owners == k)]])
        pixels, inside = camera.project(places.astype(np.float64))
        column, row = pixels[inside].astype(int).T
        mask = np.zeros((camera.height, camera.width), np.uint8)
        mask[row, column] = 1
        masks.append(cv2.dilate(mask, AROUND) > 0)
    return masks


def square_px(spikes: float) -> int:
    """Return the odd width of the squares over which gaps are averaged where a pixel's count is `spikes`: 1 is usual.

    Single spikes differ from the light by more than any model does, so that squares of LEAST_SPIKES are compared.
    """
    if spikes >= 1:
        return 1
    side = math.sqrt(LEAST_SPIKES / max(spikes, 1e-6))
    return min(WIDEST_PX, 2 * math.ceil((side - 1) / 2) + 1)


def between(instants: Sequence[float]) -> list[float]:
    """Return the instants halfway between neighbours."""
    return [(a + b) / 2 for a, b in pairwise(instants)]
