"""Judges seeded models by spikes that none was made from: counts between the swept instants."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from reconstruction.scene_model import SceneModel
from reconstruction.training.view import TrainingView
from rigs.clock import RigClock

WINDOW = 9  # planes of a count


def count_error(cloud: SceneModel, views: Sequence[TrainingView], planes: Sequence[int], clock: RigClock) -> float:
    """Return how far counts over WINDOW planes around each of `planes` are from what the cloud shows, in spikes.

    A mean over the pixels of the training views that ever see a mover; 0 where there is none.
    """
    total, pixels = 0.0, 0
    for view in views:
        for plane in planes if view.source.moving.any() else ():
            first = max(0, plane - WINDOW // 2)
            last = min(len(view.source.stream), first + WINDOW)
            moving = view.source.moving & ~view.source.useless(last)
            light = cloud.look(view.camera, clock.instant_s((first + last - 1) / 2)).intensity
            gap = view.source.counts(first, last)[moving] - light[moving] * (last - first)
            total, pixels = total + float(np.abs(gap).sum()), pixels + int(moving.sum())
    return total / pixels if pixels else 0.0


def between(planes: Sequence[int]) -> list[int]:
    """Return the planes halfway between neighbours."""
    return [(a + b) // 2 for a, b in pairwise(planes)]
