"""Nearest neighbours by a k-d tree, FLANN's exact one, instead of a matrix of all distances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SINGLE_TREE = 4  # FLANN's name for the tree that searches exactly


def nearest(points: NDArray, others: NDArray, count: int = 1) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distances [n, count] in m, nearest first, and indices of the nearest `others` [m, 3] to each point [n, 3].

    Distances are exact to float32, also far from the origin. `others` holds at least `count` points, `points` one.
    """
    import cv2

    middle = others.mean(axis=0)
    near, far = (np.ascontiguousarray(p - middle, dtype=np.float32) for p in (points, others))
    indices, squared = cv2.flann.Index(far, {"algorithm": SINGLE_TREE}).knnSearch(near, count, params={})
    order = np.argsort(squared, axis=1, kind="stable")
    distances = np.sqrt(np.take_along_axis(squared, order, axis=1).astype(np.float64))
    return distances, np.take_along_axis(indices, order, axis=1).astype(np.int64)
