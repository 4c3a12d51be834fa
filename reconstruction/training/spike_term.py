"""Compares renders with spike counts. Letters: H rows, W columns, Q parts of a window."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.losses.counts import cumulative_loss
from reconstruction.losses.picture import misplaced_light
from reconstruction.methods.definition import SpikeSampling
from reconstruction.training.draws import Draws
from reconstruction.training.image_term import ImageTerm, learnt_planes
from reconstruction.training.view import TrainingView
from rigs.camera import Camera

# Of light and counted rate, spikes per tick, the window's planes, and the noise beside a single pixel's.
RateLoss = Callable[[Tensor, Tensor, int, Tensor | float], Tensor]
PLANES_A_NODE = 8  # planes of a window for each instant rendered
MOST_NODES = 4  # instants rendered for a window


@dataclass(frozen=True)
class SpikeTerm:
    """Compares the spikes counted over a random window with the light rendered over it.

    Looks at a part of the view in which something moves, as `sampling` says. Windows are log-uniform in length; the
    light over one is a Gauss-Legendre quadrature of a few instants. `loss` compares rates over the whole window (None:
    running totals over as many equal parts of it as there are instants).
    """

    image: ImageTerm
    loss: RateLoss | None
    sampling: SpikeSampling = field(default_factory=SpikeSampling)

    def __call__(self, cloud: DynamicCloud, view: TrainingView, draws: Draws) -> Tensor:
        """Return the loss of one window."""
        part = part_with_mover(view, self.sampling.size_px, draws.rng)
        begin, end = learnt_planes(cloud, view)
        low, high = (math.log(min(x, end - begin)) for x in self.sampling.planes)
        window = round(math.exp(draws.rng.uniform(low, high)))
        first = begin + draws.place(end - begin - window + 1)
        nodes = min(MOST_NODES, math.ceil(window / PLANES_A_NODE))
        parts = 1 if self.loss else nodes
        length = window // parts
        good = torch.from_numpy(~view.source.useless(first + window)[part.within])
        starts = [first + i * length for i in range(parts)]
        renders = [self.image.over(cloud, view, part.camera, (start, length, nodes // parts)) for start in starts]
        light = torch.stack([r.intensity[..., 0] for r in renders])[:, good]
        counted = np.stack([part.counts(view, start, start + length) for start in starts])
        counts = torch.from_numpy(counted)[:, good].to(light.device)
        known = part.noise(view)
        noise = 1.0 if known is None else known[good].to(light.device)
        if self.loss:
            spikes = self.loss(light[0], counts[0] / length, length, noise).mean()
        else:
            spikes = cumulative_loss(light, counts, length, noise)
        alpha, empty = torch.stack([r.alpha for r in renders]), part.empty(view)
        if known is not None:
            alpha, empty = alpha[:, good], None if empty is None else empty[good]
        return spikes / self.image.white + self.image.solid * misplaced_light(alpha, empty)


@dataclass(frozen=True, eq=False)
class Part:
    """A rectangle of a view: its camera, its first row and column."""

    camera: Camera
    top: int
    left: int

    def counts(self, view: TrainingView, first: int, last: int) -> NDArray[np.float32]:
        """Return the spikes [H, W] over planes [first, last)."""
        return view.source.counts(first, last, self.within)

    @property
    def within(self) -> tuple[slice, slice]:
        """The rows and columns of the view that it covers."""
        height, width = self.camera.height, self.camera.width
        return slice(self.top, self.top + height), slice(self.left, self.left + width)

    def empty(self, view: TrainingView) -> Tensor | None:
        """Return the pixels [H, W] in which nothing is, 1 there and else 0; None where something is everywhere."""
        return None if view.empty is None else view.empty[self.within]

    def noise(self, view: TrainingView) -> Tensor | None:
        """Return the deviation [H, W] of counts as a share of that of recorded pixels; None where they are these."""
        way = view.source.straightening
        return torch.from_numpy(way.noise[self.within]) if way else None


def part_with_mover(view: TrainingView, size_px: tuple[int, int] | None, rng: np.random.Generator) -> Part:
    """Return a rectangle around a random pixel that moves (around any pixel where none does)."""
    camera, moving = view.camera, view.source.moving
    size_px = size_px or (camera.width, camera.height)
    width, height = min(size_px[0], camera.width), min(size_px[1], camera.height)
    seen = np.flatnonzero(moving)
    pixel = int(seen[rng.integers(len(seen))]) if len(seen) else int(rng.integers(moving.size))
    row, column = divmod(pixel, camera.width)
    top = int(np.clip(row - height // 2, 0, camera.height - height))
    left = int(np.clip(column - width // 2, 0, camera.width - width))
    lens = {"cx": camera.cx - left, "cy": camera.cy - top}
    cut = replace(camera, width=width, height=height, pixels=None, **lens)
    return Part(cut, top, left)
