"""Judges seeded models by spikes that none was made from: counts between the swept instants."""

import math
from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from reconstruction.scene_model import SceneModel
from reconstruction.training.view import TrainingView
from rigs.clock import RigClock

WINDOW = 9  # planes of a count
LEAST_SPIKES = 4.0  # of a square, where single pixels have less than one
WIDEST_PX = 15


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
            counts = view.source.counts(first, last)
            gap = np.where(moving, counts - light * (last - first), 0).astype(np.float32)
            side = square_px(float(counts[moving].mean()))
            gap = gap if side == 1 else cv2.blur(gap, (side, side), borderType=cv2.BORDER_CONSTANT)
            total, pixels = total + float(np.abs(gap[moving]).sum()), pixels + int(moving.sum())
    return total / pixels if pixels else 0.0


def square_px(spikes: float) -> int:
    """Return the odd width of the squares over which gaps are averaged where a pixel's count is `spikes`: 1 is usual.

    Single spikes differ from the light by more than any model does, so that squares of LEAST_SPIKES are compared.
    """
    if spikes >= 1:
        return 1
    side = math.sqrt(LEAST_SPIKES / max(spikes, 1e-6))
    return min(WIDEST_PX, 2 * math.ceil((side - 1) / 2) + 1)


def between(planes: Sequence[int]) -> list[int]:
    """Return the planes halfway between neighbours."""
    return [(a + b) // 2 for a, b in pairwise(planes)]
