"""Holds the bodies that were followed through a scene against the objects of the truth."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch

from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.gaussians.tracks import Leg, Track, riders_of
from reconstruction.truth import Truth
from rigs.camera import Camera
from rigs.clock import RigClock

DEPTH_SHARE = 0.03  # of its depth, by which a Gaussian may miss the surface that it belongs to
LEAST_SHARE = 0.5  # of the Gaussians of a body that are seen, which must lie on one object


class Identities(NamedTuple):
    """Counts the seams that bodies were followed across, and those after which the object behind it was another one."""

    followed: int
    switched: int


def identities(
    tracks: Sequence[Track], scene: SpannedScene, camera: Camera, truth: Truth, clock: RigClock
) -> Identities:
    """Return how often bodies were followed across a seam, and on to another object, as `camera` sees them.

    A body counts where the truth shows on either side which object it is.
    """
    planes = truth.planes(camera.id)
    followed = switched = 0
    for track in tracks:
        for before, after in pairwise(track.legs):
            seam = clock.plane(after.span.first_s)
            pair = (
                _object_of(before, scene, camera, truth, clock, [p for p in planes if p < seam][-1:]),
                _object_of(after, scene, camera, truth, clock, [p for p in planes if p >= seam][:1]),
            )
            if None not in pair:
                followed += 1
                switched += pair[0] != pair[1]
    return Identities(followed, switched)


@torch.no_grad()
def _object_of(
    leg: Leg, scene: SpannedScene, camera: Camera, truth: Truth, clock: RigClock, planes: Sequence[int]
) -> int | None:
    """Return the object that most of a body's Gaussians lie on at a plane; None where it is out of sight."""
    cloud = scene.spans[leg.number].cloud
    if not planes or cloud is None:
        return None
    frame = truth.frame(camera.id, planes[0])
    means, _ = cloud.movers(clock.instant_s(planes[0] - truth.lag_ticks))
    points = means[riders_of(cloud)[leg.body]].numpy().astype(np.float64)
    pixels, inside = camera.project(points)
    depths = camera.cam_from_rig.apply(points)[:, 2]
    columns, rows = pixels[inside].astype(int).T
    rows, columns = rows.clip(0, camera.height - 1), columns.clip(0, camera.width - 1)
    seen = np.abs(frame.depth[rows, columns] - depths[inside]) < DEPTH_SHARE * depths[inside]
    ids, counts = np.unique(frame.ids[rows, columns][seen], return_counts=True)
    if not len(ids) or counts.max() < LEAST_SHARE * counts.sum():
        return None
    return int(ids[counts.argmax()])
