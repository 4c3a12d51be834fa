"""Pairs of views as the network sees them: the pose of each view along a spanning tree, and a similarity for each pair.

Letters: v views, n sampled pixels of each, m points. Source: Wang et al., "DUSt3R", CVPR 2024, sections 3.3 and 3.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import GeometryError
from rigs.similarity import Similarity
from rigs.transform import Floats, Transform

ROUNDS = 20
PNP_POINTS = 1000
PNP_TRIALS = 200
PNP_TOLERANCE = 0.015  # in units of the focal length, 5 pixels at 350
LEAST_INLIERS = 0.5  # share of a view's points that one pose explains
LEAST_LOG_CONFIDENCE = 0.1
SMALL = 1e-9


@dataclass(frozen=True, eq=False)
class PairMaps:
    """The network's answer to two views, numbered `first` and `second`.

    `points` [2, n, 3]: of the first and of the second view's pixels, both in the first camera's frame, at a scale of
    the pair's own. `confidence` [2, n] >= 1, larger is better.
    """

    first: int
    second: int
    points: NDArray[np.float32]
    confidence: NDArray[np.float32]

    @property
    def weights(self) -> Floats:
        """Return the logarithm of the confidence [2, n]; 0 where a point is not finite."""
        usable = np.isfinite(self.points).all(axis=-1) & np.isfinite(self.confidence)
        return np.where(usable, np.log(np.maximum(np.where(usable, self.confidence, 1), 1)), 0).astype(np.float64)

    @property
    def finite_points(self) -> Floats:
        """Return the points [2, n, 3], zero where one is not finite."""
        points = self.points.astype(np.float64)
        return np.where(np.isfinite(points).all(axis=-1, keepdims=True), points, 0)


@dataclass(frozen=True, eq=False)
class Start:
    """`cam_from_world` of each view, its points [v, n, 3] in the world, and world_from_pair of each pair."""

    cam_from_world: list[Transform]
    points: Floats
    world_from_pair: list[Similarity]


@dataclass(frozen=True, eq=False)
class Link:
    """A pair that can be trusted: the second camera's pose in the first one's frame, and how good it is."""

    maps: PairMaps
    second_from_first: Transform
    score: float


def registered(source: Floats, target: Floats, weights: Floats) -> Similarity:
    """Return the similarity that lays points [m, 3] on their partners [m, 3] with the least weighted sum of distances.

    Umeyama's closed form ("Least-squares estimation of transformation parameters", PAMI 1991), weighed again and again.
    """
    near = weights
    found = Similarity(1.0, np.eye(3), np.zeros(3))
    for _ in range(ROUNDS):
        found = _least_squares(source, target, near)
        apart = np.linalg.norm(found.apply(source) - target, axis=1)
        floor = max(1e-3 * float(np.median(apart)), SMALL)
        near = weights / np.maximum(apart, floor)
    return found


def _least_squares(source: Floats, target: Floats, weights: Floats) -> Similarity:
    share = weights / max(float(weights.sum()), SMALL)
    a, b = share @ source, share @ target
    spread = source - a
    u, sizes, vt = np.linalg.svd((target - b).T @ (share[:, None] * spread))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(signs) @ vt
    scale = max(float(sizes @ signs) / max(float(share @ (spread**2).sum(axis=1)), SMALL), SMALL)
    return Similarity(scale, rotation, b - scale * rotation @ a)


def link(pair: PairMaps, rays: Floats) -> Link | None:
    """Return the second camera's pose from where its points are seen [n, 2]; None where the pair says too little."""
    points, weights = pair.finite_points, pair.weights
    usable = np.flatnonzero(weights[1] > 0)
    if len(usable) < 6 or weights.mean(axis=1).min() < LEAST_LOG_CONFIDENCE:
        return None
    chosen = usable[np.linspace(0, len(usable) - 1, min(PNP_POINTS, len(usable))).astype(np.intp)]
    unit = float(np.median(np.linalg.norm(points[1, chosen], axis=1)))
    if not unit > 0:
        return None
    try:
        found, turn, shift, inliers = cv2.solvePnPRansac(
            points[1, chosen] / unit,
            rays[pair.second, chosen],
            np.eye(3),
            None,
            iterationsCount=PNP_TRIALS,
            reprojectionError=PNP_TOLERANCE,
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:  # points without any shape
        return None
    share = 0.0 if not found or inliers is None else len(inliers) / len(chosen)
    if share < LEAST_INLIERS or not np.isfinite([turn, shift]).all():
        return None
    pose = Transform.from_rotvec(turn.ravel(), shift.ravel() * unit)
    return Link(pair, pose, share * float(weights[0].mean() * weights[1].mean()))


def _tree(names: Sequence[str], links: Sequence[Link]) -> list[Link]:
    """Return the best links that reach every view, each touching an earlier one; GeometryError names the others."""
    left = sorted(links, key=lambda x: (-x.score, x.maps.first, x.maps.second))
    best: list[Link] = []
    while left:
        tree, reached = [], {left[0].maps.first}
        while True:
            edge = next((x for x in left if (x.maps.first in reached) != (x.maps.second in reached)), None)
            if edge is None:
                break
            tree.append(edge)
            reached |= {edge.maps.first, edge.maps.second}
        best = max(best, tree, key=len)
        left = [x for x in left if x.maps.first not in reached]
    reached = {v for x in best for v in (x.maps.first, x.maps.second)}
    lost = [name for v, name in enumerate(names) if v not in reached]
    if lost:
        advice = "leave it out" if len(lost) == 1 else "leave them out"
        raise GeometryError(f"found no overlap of {', '.join(lost)} with the other views", "some", advice)
    return best


def started(names: Sequence[str], rays: Floats, pairs: Sequence[PairMaps]) -> Start:
    """Place all views along the best tree of pairs; `rays` [v, n, 2] as the true lenses see.

    The world is the frame and scale of the best pair's first camera. GeometryError names views that nothing reaches.
    """
    tree = _tree(names, [found for pair in pairs if (found := link(pair, rays)) is not None])
    root = tree[0].maps
    poses = {root.first: Transform.identity()}
    clouds = {root.first: root.finite_points[0]}
    trust = {root.first: root.weights[0]}
    for edge in tree:
        old, new = (0, 1) if edge.maps.first in poses else (1, 0)
        views = (edge.maps.first, edge.maps.second)
        points, weights = edge.maps.finite_points, edge.maps.weights
        world = registered(points[old], clouds[views[old]], np.sqrt(weights[old] * trust[views[old]]))
        poses[views[new]] = world.carry(edge.second_from_first if new == 1 else Transform.identity())
        clouds[views[new]], trust[views[new]] = world.apply(points[new]), weights[new]
    numbers = range(len(names))
    cloud = np.stack([clouds[v] for v in numbers])
    ahead = [float((poses[v].apply(cloud[v])[:, 2] > 0).mean()) for v in numbers]
    behind = [name for name, share in zip(names, ahead, strict=True) if share < LEAST_INLIERS]
    if behind:
        raise GeometryError(f"found the points of {', '.join(behind)} behind their camera", "them ahead")
    weight = np.stack([trust[v] for v in numbers])
    similarities = []
    for pair in pairs:
        both = [pair.first, pair.second]
        shared = np.sqrt(pair.weights * weight[both])
        similarities.append(registered(pair.finite_points.reshape(-1, 3), cloud[both].reshape(-1, 3), shared.ravel()))
    return Start([poses[v] for v in numbers], cloud, similarities)
