"""What a step asks of a radiance field: that light integrated along single rays explains their pixels' spike counts.

A pixel integrates light and fires at a threshold; with a random phase at the start, its expected count over a window is
the light it gathered, in thresholds. So the neuron layer of SpikeNeRF (Zhu et al., CVPR 2024) is taken in expectation,
and what phases, photons and thresholds that differ between pixels do to a count is the width of the loss
(`losses.counts.robust_loss`; published: a learnt map of thresholds). Where nothing moves, the window is the whole clip,
the longest term there is. Letters: R rays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.fields.field import RadianceField
from reconstruction.fields.march import STEP, march
from reconstruction.losses.counts import robust_loss
from reconstruction.training.closeness import Closeness
from reconstruction.training.supervision import TrainingView, quadrature
from rigs.clock import RigClock

RAYS = "rays"  # the name of this supervision


@dataclass(frozen=True)
class RayTerm:
    """Counts of `rays` random pixels of a view; half of them see a mover, where there is any.

    Windows over movers are log-uniform between `shortest` and `longest` planes, their integral a quadrature of at most
    `most_nodes` instants. `solid` works against light that passes through everything, `smooth` against noise: what
    `sampled` random cells differ from their neighbours by. `white` is the data range in spikes per tick.
    """

    clock: RigClock
    white: float
    closeness: Closeness | None = None
    rays: int = 16384
    shortest: int = 8
    longest: int = 33
    planes_a_node: int = 16
    most_nodes: int = 2
    solid: float = 0.02
    smooth: float = 0.1
    sampled: int = 16384

    def __call__(self, field: RadianceField, view: TrainingView, rng: np.random.Generator, shrink: int) -> Tensor:
        """The loss of one window; spikes are counted at full size, so `shrink` is of no account."""
        planes = len(view.source.stream)
        low, high = (math.log(min(x, planes)) for x in (self.shortest, self.longest))
        window = round(math.exp(rng.uniform(low, high)))
        first = int(rng.integers(planes - window + 1))
        drawn = self._drawn(view, (first, window), rng)
        light, alpha = self._integral(field, view, np.concatenate([pixels for pixels, _, _ in drawn]), (first, window), rng)
        parts, spikes = light.split([len(pixels) for pixels, _, _ in drawn]), torch.zeros(())
        for part, (_, rates, length) in zip(parts, drawn, strict=True):
            spikes = spikes + robust_loss(part, rates, length) * (len(part) / len(light))
        if self.closeness:
            self.closeness.see(light.detach(), torch.cat([rates for _, rates, _ in drawn]))
        cells = torch.from_numpy(rng.integers(len(field), size=self.sampled))
        return spikes / self.white + self.solid * (1 - alpha).mean() + self.smooth * field.variation(cells)

    def _drawn(
        self, view: TrainingView, span: tuple[int, int], rng: np.random.Generator
    ) -> list[tuple[NDArray[np.int64], Tensor, int]]:
        """Random pixels, still ones and movers: which, their rates in spikes per tick, and the planes these are over."""
        source, (first, window) = view.source, span
        last, good = first + window, ~source.background.stuck
        still, moving = (np.flatnonzero(good & mask) for mask in (~source.moving, source.moving))
        images = [
            (still, lambda: source.background.image * np.float32(source.light.over(first, last)), len(source.stream)),
            (moving, lambda: source.stream.counts(first, last) / np.float32(window), window),
        ]
        images = [image for image in images if len(image[0])]
        drawn = []
        for seen, image, planes in images:
            pixels = seen[rng.integers(len(seen), size=self.rays // len(images))]
            drawn.append((pixels, torch.from_numpy(image().ravel()[pixels].astype(np.float32)), planes))
        return drawn

    def _integral(
        self,
        field: RadianceField,
        view: TrainingView,
        pixels: NDArray[np.int64],
        span: tuple[int, int],
        rng: np.random.Generator,
    ) -> tuple[Tensor, Tensor]:
        """Mean light and alpha [R] over the planes of the span (first, length)."""
        first, length = span
        rows, columns = np.divmod(pixels, view.camera.width)
        lines = field.frustum.rays(view.camera, columns, rows).lines
        nodes = min(self.most_nodes, math.ceil(length / self.planes_a_node)) if len(field.moving) else 1
        light, alpha = torch.zeros(()), torch.zeros(())
        for place, weight in zip(*quadrature(nodes), strict=True):
            jitter = torch.from_numpy(rng.random(len(pixels), dtype=np.float32))
            seen = march(field.grids, lines, jitter, STEP, field.at(self.clock.instant_s(first + length * place - 0.5)))
            light, alpha = light + weight * seen.light, alpha + weight * seen.alpha
        return light, alpha
