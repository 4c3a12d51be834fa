"""Losses on neighbours that do not move as one rigid piece; zero, without a gradient, where they do.

Letters: M Gaussians, k neighbours of each. Distances are measured against the mean gap between neighbours, so that one
weight fits scenes of any size. Source: Luiten et al., "Dynamic 3D Gaussians", 3DV 2024, equations 4 to 8. Not as there:
weights are exp(-SHARPNESS d^2 / mean d^2) and sum to one for each Gaussian; there they are exp(-2000 d^2), d in m.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from reconstruction.quaternions import product, rotated

NEIGHBOURS = 8  # published: 20, of ten times as many Gaussians
SHARPNESS = 1.0
ROWS = 1024  # rows of the matrix of all distances that are held at a time
TINY = 1e-6  # mean gaps; a shorter length pulls as its square
RIGID, ROTATION, ISOMETRY = 4.0, 4.0, 2.0  # weights against one another, as published


class Neighbourhood(NamedTuple):
    """The k neighbours of M Gaussians, each [M, k]: `indices` int64, `weights` that sum to 1, `distances` in m."""

    indices: Tensor
    weights: Tensor
    distances: Tensor


def neighbourhood(means: Tensor) -> Neighbourhood:
    """Return the nearest others of each of `means` [M, 3] in m; k is NEIGHBOURS, or M - 1 where there are fewer."""
    means = means.detach()
    count = min(NEIGHBOURS, max(len(means) - 1, 0))
    found = []
    for rows in torch.arange(len(means)).split(ROWS):
        apart = torch.cdist(means[rows], means, compute_mode="donot_use_mm_for_euclid_dist")
        apart[torch.arange(len(rows)), rows] = torch.inf  # none is its own neighbour
        found.append(apart.topk(count, largest=False))
    if not found:
        return Neighbourhood(torch.zeros(0, 0, dtype=torch.int64), means.new_zeros(0, 0), means.new_zeros(0, 0))
    distances, indices = (torch.cat(parts) for parts in zip(*found, strict=True))
    return Neighbourhood(indices, weights_of(distances), distances)


def weights_of(distances: Tensor) -> Tensor:
    """Return weights [M, k] of neighbours at `distances` [M, k], larger for nearer ones; even where all coincide."""
    if distances.numel() == 0:
        return distances
    relative = distances / distances.amax(dim=1, keepdim=True).clamp_min(torch.finfo(distances.dtype).tiny)
    mean_square = relative.square().mean(dim=1, keepdim=True).clamp_min(torch.finfo(distances.dtype).tiny)
    return torch.softmax(-SHARPNESS * relative.square() / mean_square, dim=1)


def rigidity(near: Neighbourhood, before: tuple[Tensor, Tensor], now: tuple[Tensor, Tensor]) -> Tensor:
    """Return the weighted sum of three losses, each a mean over M, between two states (means [M, 3], quats [M, 4]).

    Means are in m, quaternions unit. Rigid: a neighbour's offset turns with the Gaussian. Rotation: neighbours turn
    alike. Isometry: neighbours keep the distances of `near`.
    """
    (places, quats), (moved, turned) = before, now
    count, k = near.indices.shape
    gap = near.distances.mean().clamp_min(torch.finfo(near.distances.dtype).tiny)
    turns = product(turned, quats * quats.new_tensor([1.0, -1, -1, -1]))
    offsets, after = ((p[near.indices] - p[:, None]).reshape(-1, 3) / gap for p in (places, moved))
    rigid = _length(rotated(turns.repeat_interleave(k, dim=0), offsets) - after)
    rotation = _length((turns[near.indices] - turns[:, None]).reshape(-1, 4))
    isometry = _length((_length(after) + TINY - near.distances.reshape(-1) / gap)[:, None])
    losses = RIGID * rigid + ROTATION * rotation + ISOMETRY * isometry
    return (near.weights.reshape(-1) * losses).sum() / max(count, 1)


def _length(vectors: Tensor) -> Tensor:
    """Return Euclidean lengths [n] of `vectors` [n, D], rounded at zero so that their gradient is finite there."""
    return torch.sqrt(vectors.square().sum(dim=1) + TINY**2) - TINY
