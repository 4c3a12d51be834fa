"""Adds points on edges of still things to an adjustment: plain rooms have few features, but borders everywhere.

The cameras found so far are good to a few pixels. Each place on an edge of a middle view is tried at many depths; the
one is taken at which most other views have an edge. Then, in rounds, each view says how far across itself its nearest
edge is. Letters: E places on edges, D depths, V views, O observations.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reconstruction.calibration.adjustment import Solution, adjust
from reconstruction.calibration.edges import Edges
from reconstruction.calibration.matches import Gate
from reconstruction.calibration.problem import Loss, Observations, Problem, ScenePoints
from reconstruction.calibration.projection import Cameras, project
from rigs.transform import Floats

EDGE_SD_PX = 0.1
CELL_PX = 6  # one place on an edge in each cell: what is nearer errs alike
DEPTHS = 160
NEIGHBOURS = 8  # depths to either side that count as the same
SEEN_SHARE = 0.5  # least votes, as a share of the other views
CLEAR = 0.75  # most votes of another depth, as a share of the best's
ROUNDS_PX = (4.0, 2.0, 1.0, 1.0)  # how far off the nearest edge may be
BEND_PX = 0.3  # Cauchy's, at the end
STEPS = 40


def with_edges(solution: Solution, edges: Sequence[Edges], gate: Gate, distance_m: float) -> tuple[Solution, int]:
    """Adjust on with points on the `edges` of each view, and return how many there are.

    `gate` has the depths that are tried, in object distances `distance_m`. The solution stays as it is without points.
    """
    cameras, points = solution.state.cameras, solution.problem.observations
    middle = int(np.linalg.norm(cameras.centers - cameras.centers.mean(axis=0), axis=1).argmin())
    own = _thinned(edges[middle])
    near, far = gate.nearest * distance_m, gate.farthest * distance_m
    sure, positions = placed(cameras, edges, middle, own, 1 / np.linspace(1 / far, 1 / near, DEPTHS))
    own = own.only(sure)
    if not len(own):
        return solution, 0
    before = solution.state.blocks
    assert isinstance(before, ScenePoints)
    every = len(before) + np.arange(len(own))
    state = replace(solution.state, blocks=ScenePoints(np.concatenate([before.positions, positions])))
    for within_px in ROUNDS_PX:
        seen = observed(state.cameras, state.blocks.place(every)[0], edges, middle, own, within_px)
        observations = Observations.joined([points, replace(seen, block=every[seen.block])])
        loss = Loss("cauchy", max(BEND_PX, within_px / 4) / EDGE_SD_PX)
        solution = Solution(Problem(observations, solution.problem.freedom, loss), state)
        state = adjust(solution.problem, state, STEPS)
    return replace(solution, state=state), len(own)


def placed(
    cameras: Cameras, edges: Sequence[Edges], middle: int, own: Edges, depths_m: Floats
) -> tuple[np.ndarray, Floats]:
    """Find the points of places on the edges `own` of the view `middle`, by votes of the others at depths [D] in m.

    Returns which of them [E] are sure, and the positions of those in m.
    """
    rays = np.insert(cameras.slopes(own.places, np.full(len(own), middle)), 2, 1.0, axis=1)
    tried = cameras.centers[middle] + (rays * depths_m[:, None, None]) @ cameras.rotations[middle]
    votes = np.zeros(tried.shape[:2])
    facing = np.tile(own.normals, (len(depths_m), 1))
    for view in set(range(len(cameras))) - {middle}:
        at = project(tried.reshape(-1, 3), cameras, np.full(votes.size, view))
        _, apart = edges[view].nearest(at.pixels, facing)
        votes += (np.maximum(0.0, 1 - (apart / ROUNDS_PX[0]) ** 2) * at.seen).reshape(votes.shape)
    best = votes.argmax(axis=0)
    most = votes.max(axis=0)
    elsewhere = np.abs(np.arange(len(depths_m))[:, None] - best) > NEIGHBOURS
    next_most = np.where(elsewhere, votes, 0.0).max(axis=0)
    sure = (most > SEEN_SHARE * (len(cameras) - 1)) & (next_most < CLEAR * most)
    return sure, tried[best, np.arange(len(own))][sure]


def observed(
    cameras: Cameras, positions: Floats, edges: Sequence[Edges], middle: int, own: Edges, within_px: float
) -> Observations:
    """Return what each view's edges say, across themselves, of points [E, 3] in m; the middle view holds its places."""
    every = np.arange(len(own))
    both = np.full((len(own), 2), np.nan)
    parts = [Observations(np.full(len(own), middle), every, own.places, np.full(len(own), EDGE_SD_PX), both)]
    for view in set(range(len(cameras))) - {middle}:
        at = project(positions, cameras, np.full(len(positions), view))
        edge, apart = edges[view].nearest(at.pixels, own.normals)
        seen = np.flatnonzero((apart < within_px) & at.seen)
        which, sds = np.full(len(seen), view), np.full(len(seen), EDGE_SD_PX)
        parts.append(Observations(which, seen, edges[view].places[edge[seen]], sds, edges[view].normals[edge[seen]]))
    return Observations.joined(parts)


def _thinned(edges: Edges) -> Edges:
    """Keep the steepest place of the edges in each cell."""
    order = np.argsort(-edges.slopes, kind="stable")
    cells = np.floor(edges.places[order] / CELL_PX).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return edges.only(order[first])
