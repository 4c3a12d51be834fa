"""Compares light that a radiance field integrates along single rays with the spike counts of their pixels.

A pixel integrates light and fires at a threshold; with a random phase at the start, its expected count over a window is
the light it gathered, in thresholds. So the neuron layer of SpikeNeRF (Zhu et al., CVPR 2024) is taken in expectation,
and what phases, photons and thresholds that differ between pixels do to a count is the width of the loss
(`losses.counts.robust_loss`; published: a learnt map of thresholds). Where nothing moves, the window is the whole clip,
the longest term there is. Letters: R rays.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.losses.counts import robust_loss
from reconstruction.losses.picture import misplaced_light
from reconstruction.radiance_fields.march import STEP, march
from reconstruction.radiance_fields.radiance_field import RadianceField
from reconstruction.training.closeness import Closeness
from reconstruction.training.draws import Draws
from reconstruction.training.image_term import quadrature
from reconstruction.training.view import TrainingView
from rigs.clock import RigClock

RAYS = "rays"  # the name of this supervision
SQUARE = 16  # pixels, width of the squares that rays are drawn in


@dataclass(frozen=True)
class RayTerm:
    """Counts of about `rays` pixels of a view in random squares, of which every other lies on a mover if there is any.

    Windows over movers are log-uniform between `shortest` and `longest` planes, their integral a quadrature of at most
    `most_nodes` instants. `solid` works against light that passes through everything, `smooth` against noise, which is
    what `sampled` random cells differ from their neighbours by. `white` is the data range in spikes per tick.
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

    def __call__(self, field: RadianceField, view: TrainingView, draws: Draws) -> Tensor:
        """Return the loss of one window."""
        rng, planes = draws.rng, len(view.source.stream)
        low, high = (math.log(min(x, planes)) for x in (self.shortest, self.longest))
        window = round(math.exp(rng.uniform(low, high)))
        first = draws.place(planes - window + 1)
        pixels = self._drawn(view, first + window, rng)
        light, alpha = self._integral(field, view, pixels, (first, window), rng)
        spikes, rates = self._explained(light, view, pixels, (first, window))
        if self.closeness:
            self.closeness.see(float((light.detach() - rates).square().mean()))
        cells = torch.from_numpy(rng.integers(len(field), size=self.sampled))
        empty = None if view.empty is None else view.empty.ravel()[torch.from_numpy(pixels)]
        return spikes / self.white + self.solid * misplaced_light(alpha, empty) + self.smooth * field.variation(cells)

    def _drawn(self, view: TrainingView, last: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Return the pixels [R] of random squares, of use before plane `last`; neighbours read the same cells."""
        height, width = view.source.moving.shape
        tall, wide = min(SQUARE, height), min(SQUARE, width)
        seen, count = np.flatnonzero(view.source.moving), -(-self.rays // (tall * wide))
        middles = rng.integers(height * width, size=count)
        if len(seen):
            middles[::2] = seen[rng.integers(len(seen), size=len(middles[::2]))]
        rows, columns = np.divmod(np.sort(middles), width)
        tops = np.clip(rows - tall // 2, 0, height - tall)[:, None, None] + np.arange(tall)[:, None]
        lefts = np.clip(columns - wide // 2, 0, width - wide)[:, None, None] + np.arange(wide)
        pixels = (tops * width + lefts).ravel()
        return pixels[~view.source.useless(last).ravel()[pixels]]

    def _explained(
        self, light: Tensor, view: TrainingView, pixels: NDArray[np.int64], span: tuple[int, int]
    ) -> tuple[Tensor, Tensor]:
        """Return the loss of `light` [R] over the span (first, length) and the rates [R] counted, spikes per tick."""
        source, (first, window) = view.source, span
        gain = np.float32(source.light.over(first, first + window))
        rates = torch.from_numpy(source.background.image.ravel()[pixels] * gain)
        moving = torch.from_numpy(source.moving.ravel()[pixels])
        way, loss = source.straightening, torch.zeros(())
        noise = torch.from_numpy(way.noise.ravel()[pixels]) if way else torch.ones(len(pixels))
        if moving.any():
            counts = source.counts(first, first + window).ravel()[pixels]
            rates = torch.where(moving, torch.from_numpy(counts / window), rates)
            loss = robust_loss(light[moving], rates[moving], window, noise[moving]).mean() * moving.float().mean()
        if not moving.all():
            still = robust_loss(light[~moving], rates[~moving], len(source.stream), noise[~moving]).mean()
            loss = loss + still * (~moving).float().mean()
        return loss, rates

    def _integral(
        self,
        field: RadianceField,
        view: TrainingView,
        pixels: NDArray[np.int64],
        span: tuple[int, int],
        rng: np.random.Generator,
    ) -> tuple[Tensor, Tensor]:
        """Return the mean light and alpha [R] over the planes of the span (first, length)."""
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
