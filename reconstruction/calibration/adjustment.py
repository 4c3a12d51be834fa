"""Rig bundle adjustment: Levenberg-Marquardt over the cameras, after their targets are eliminated (Schur complement).

The targets are blocks of any size: a point of the scene has 3 unknowns, the pose of a board 6. Robust losses work by
iterative reweighting; every camera parameter has a prior. The cameras' covariance is the sandwich over blocks, which
also holds where the residuals of one block err together.
Letters: C cameras, G free parameters, L blocks of D unknowns, O observations.
Source: Triggs et al., "Bundle adjustment: a modern synthesis", 1999.
"""

from dataclasses import dataclass

import numpy as np

from reconstruction.calibration.problem import Indices, Problem, State
from reconstruction.calibration.projection import Projection, project
from reconstruction.errors import GeometryError
from rigs.transform import Floats

ITERATIONS = 30
MOST_DAMPING = 1e8
SINGULAR = 1e-12  # least share of a value's information that is left once blocks are free; rounding alone leaves 1e-16
UNSEEN_PX = 100.0  # residual of a point behind its camera


@dataclass(frozen=True, eq=False)
class Linearised:
    """The normal equations at a state. `cost` is the robust one with priors.

    Cameras: `hessian` [G, G], `gradient` [G]; blocks: [L, D, D], [L, D]; `coupling` [L, G, D]; `scores` [L, G], the
    camera gradient of each block's observations. `residuals` [O, 2] in px.
    """

    cost: float
    residuals: Floats
    hessian: Floats
    gradient: Floats
    block_hessian: Floats
    block_gradient: Floats
    coupling: Floats
    scores: Floats


@dataclass(frozen=True, eq=False)
class Solution:
    """The state of least cost, and the problem it solves."""

    problem: Problem
    state: State

    def moved(self, group: str) -> float:
        """Return the sum of all steps of the one value of a group."""
        return float(self.state.steps[self.problem.freedom.of(group)].item())


def cost(problem: Problem, state: State) -> float:
    """Return the robust cost of a state, with priors."""
    points, _ = state.blocks.place(problem.observations.block)
    seen = project(points, state.cameras, problem.observations.camera)
    squared, _ = _residuals(problem, seen)
    return float(problem.loss.cost(squared).sum() + _prior(problem, state)[0])


def linearised(problem: Problem, state: State) -> Linearised:
    """Return the normal equations at `state`."""
    obs, count, blocks = problem.observations, len(state.cameras), len(state.blocks)
    points, by_block = state.blocks.place(obs.block)
    seen = project(points, state.cameras, obs.camera)
    squared, residuals = _residuals(problem, seen)
    root = (np.sqrt(problem.loss.weight(squared)) / obs.sd_px * seen.seen)[:, None]
    mixing = problem.freedom.mixing
    used = np.flatnonzero(mixing.any(axis=(0, 2)))  # most camera parameters are not free
    mixing = mixing[:, used]
    jc, jb, r = (
        root[:, :, None] * obs.measured(seen.by_camera[:, :, used]),
        root[:, :, None] * obs.measured(seen.by_point @ by_block),
        root * residuals,
    )
    p, d = jc.shape[2], jb.shape[2]
    pair = obs.block * count + obs.camera
    jct, jbt = jc.transpose(0, 2, 1), jb.transpose(0, 2, 1)
    coupling = _summed(jct @ jb, pair, blocks * count).reshape(blocks, count * p, d)
    scores = _summed((jct @ r[:, :, None])[:, :, 0], pair, blocks * count).reshape(blocks, count * p)
    local = _summed(jct @ jc, obs.camera, count)
    flat = mixing.reshape(count * p, mixing.shape[2])
    scores = scores @ flat
    prior_cost, prior_gradient, precision = _prior(problem, state)
    return Linearised(
        float(problem.loss.cost(squared).sum() + prior_cost),
        residuals,
        np.einsum("cpg,cpq,cqh->gh", mixing, local, mixing, optimize=True) + np.diag(precision),
        scores.sum(axis=0) + prior_gradient,
        _summed(jbt @ jb, obs.block, blocks),
        _summed((jbt @ r[:, :, None])[:, :, 0], obs.block, blocks),
        np.einsum("lkd,kg->lgd", coupling, flat, optimize=True),
        scores,
    )


def _residuals(problem: Problem, seen: Projection) -> tuple[Floats, Floats]:
    """Return the measured residuals: squared in standard deviations [O], and in px [O, 2]."""
    obs = problem.observations
    off = obs.measured((seen.pixels - obs.pixels)[:, :, None])[:, :, 0]
    residuals = np.where(seen.seen[:, None], off, UNSEEN_PX)
    return (residuals**2).sum(axis=1) / obs.sd_px**2, residuals


def _prior(problem: Problem, state: State) -> tuple[float, Floats, Floats]:
    """Cost, gradient [G] and precision [G] of the priors."""
    precision = 1 / problem.freedom.prior_sd**2
    return float((precision * state.steps**2).sum()), precision * state.steps, precision


def adjust(problem: Problem, state: State, iterations: int = ITERATIONS, least_gain: float = 1e-6) -> State:
    """Return the state of least cost near `state`; a step that gains less than `least_gain` of the cost is the last."""
    damping, growth = 1e-4, 4.0
    current = linearised(problem, state)
    for _ in range(iterations):
        while damping < MOST_DAMPING:
            tried = _stepped(problem, state, current, damping)
            tried_cost = cost(problem, tried) if tried else np.inf
            if tried and tried_cost < current.cost:
                break
            damping, growth = damping * growth, growth * 2
        else:
            return state
        gained = current.cost - tried_cost
        state, damping, growth = tried, max(damping / 3, 1e-9), 4.0
        if gained <= least_gain * tried_cost:
            return state
        current = linearised(problem, state)
    return state


def _stepped(problem: Problem, state: State, at: Linearised, damping: float) -> State | None:
    """Return the state one damped step further; None where the equations have no solution."""
    try:
        inverse = _inverse(at.block_hessian, damping)
        reduced, gradient = _reduced(at, inverse)
        scale = np.maximum(np.diag(at.hessian), 1e-12)
        camera_step = -np.linalg.solve(reduced + np.diag(damping * scale), gradient)
    except np.linalg.LinAlgError:
        return None
    back = at.block_gradient + np.einsum("lgd,g->ld", at.coupling, camera_step)
    block_step = -np.einsum("lde,le->ld", inverse, back)
    if not (np.isfinite(camera_step).all() and np.isfinite(block_step).all()):
        return None
    steps = problem.freedom.mixing @ camera_step
    return State(state.cameras.moved(steps), state.blocks.moved(block_step), state.steps + camera_step)


def _inverse(hessians: Floats, damping: float) -> Floats:
    """Invert Hessians [L, D, D], each diagonal raised by `damping` of itself; unseen blocks get large finite ones."""
    diagonal = np.einsum("ldd->ld", hessians)
    raised = damping * diagonal + 1e-10 * diagonal.max(axis=1, keepdims=True, initial=0.0) + 1e-12
    return np.asarray(np.linalg.inv(hessians + np.eye(diagonal.shape[1]) * raised[:, :, None]), dtype=np.float64)


def _reduced(at: Linearised, inverse: Floats) -> tuple[Floats, Floats]:
    """Eliminate the blocks from the cameras' equations, given the inverses [L, D, D] of the blocks' Hessians."""
    folded = at.coupling @ inverse
    blocks, g, d = folded.shape
    wide, plain = (a.transpose(1, 0, 2).reshape(g, blocks * d) for a in (folded, at.coupling))
    reduced = at.hessian - wide @ plain.T
    return reduced, at.gradient - np.einsum("lgd,ld->g", folded, at.block_gradient)


def covariance(problem: Problem, state: State) -> Floats:
    """Return the covariance [G, G] of the free camera values: the sandwich over blocks, with priors.

    Raises GeometryError where observations and priors do not determine the values: the sandwich would not show it.
    """
    at = linearised(problem, state)
    # What one camera alone sees has no depth: its block is singular.
    inverse = np.asarray(np.linalg.pinv(at.block_hessian, SINGULAR, hermitian=True), dtype=np.float64)
    reduced, _ = _reduced(at, inverse)
    scale = 1 / np.sqrt(np.maximum(np.diag(at.hessian), np.finfo(np.float64).tiny))
    if not np.linalg.eigvalsh(reduced * np.outer(scale, scale))[0] > SINGULAR:
        found = "found cameras that the observations leave free"
        raise GeometryError(found, "them determined", "show the cameras a deeper scene")
    scores = at.scores - np.einsum("lgd,lde,le->lg", at.coupling, inverse, at.block_gradient)
    bread = np.linalg.inv(reduced)
    meat = scores.T @ scores + np.diag(1 / problem.freedom.prior_sd**2)
    return bread @ meat @ bread


def _summed(values: Floats, which: Indices, count: int) -> Floats:
    """Sum the values [O, ...] that go to the same of `count` places, to [count, ...]."""
    order = np.argsort(which, kind="stable")
    places, first = np.unique(which[order], return_index=True)
    found = np.zeros((count, *values.shape[1:]))
    if len(places):
        found[places] = np.add.reduceat(values[order], first, axis=0)
    return found
