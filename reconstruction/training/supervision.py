"""What a step asks of the render: to look like an image, to change as the images do, or to explain the spikes.

A term draws its own instants from `rng` and returns a scalar loss. Letters: H rows, W columns, Q instants of a window.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.motion import Instantaneous
from reconstruction.images.composite import CompositeSource
from reconstruction.losses.counts import cumulative_loss, robust_loss
from reconstruction.losses.ssim import ssim
from reconstruction.losses.variation import variation_loss
from reconstruction.rendering.render import Backend, Rendering, render
from reconstruction.training.closeness import Closeness
from reconstruction.training.depth_hold import ConfirmedDepth, DepthHold
from reconstruction.training.exposure import Exposure, mean_of
from reconstruction.training.refinement import Correction
from rigs.camera import Camera
from rigs.clock import RigClock

SpikeNorm = Literal["l1", "l2", "counts", "cumulative"]


@dataclass(frozen=True, eq=False)
class TrainingView:
    """A camera, the images it should see, and what of the camera is being refined (None: it stands as it is).

    `depth`: where it is known before the training.
    """

    camera: Camera
    source: CompositeSource
    correction: Correction | None = None
    depth: ConfirmedDepth | None = None

    def seen(self, cloud: DynamicCloud, instant_s: float) -> Instantaneous:
        """What to render for it at an instant."""
        return self.correction.seen(cloud, instant_s) if self.correction else cloud.at(instant_s)


Term = Callable[[Any, TrainingView, np.random.Generator], Tensor]


@dataclass(frozen=True)
class ImageTerm:
    """L1 and SSIM against the target image of one instant.

    `white` is the data range in spikes per tick; instants are every `stride`-th plane, so that target images can be
    kept; `solid` works against light that passes through everything: dark texture is not a hole. `closeness` is told
    of every image compared; `hold` keeps to depths that the view knows. `exposure` knows what planes an image is the
    mean of; without it, it shows an instant. Images take the float type that `backend` renders the cloud in.
    """

    clock: RigClock
    white: float
    stride: int = 1
    ssim: float = 0.2
    solid: float = 0.02
    closeness: Closeness | None = None
    backend: Backend = "native"
    hold: DepthHold | None = None
    exposure: Exposure | None = None

    def __call__(self, cloud: DynamicCloud, view: TrainingView, rng: np.random.Generator) -> Tensor:
        """The loss at a random plane."""
        instants = _instants(cloud, view, self.stride)
        plane = int(instants[rng.integers(len(instants))])
        return self.held(view, *self.pair(cloud, view, plane))

    def pair(self, cloud: DynamicCloud, view: TrainingView, plane: int) -> tuple[Rendering, Tensor]:
        """What is rendered and what should be, at `plane`."""
        span = self.exposure.span(plane, len(view.source.stream)) if self.exposure else (plane, 1, 1)
        rendered = self.over(cloud, view, view.camera, span)
        return rendered, torch.from_numpy(view.source.at(plane)).to(rendered.intensity.dtype)

    def over(self, cloud: DynamicCloud, view: TrainingView, camera: Camera, span: tuple[int, int, int]) -> Rendering:
        """The mean of what `camera` sees in a span: its first plane, how many, and how many instants stand for them."""
        first, length, nodes = span
        renders = []
        for node, weight in zip(*quadrature(nodes if cloud.changes else 1), strict=True):
            instant_s = self.clock.instant_s(first + length * node - 0.5)
            renders.append((weight, render(view.seen(cloud, instant_s), camera, backend=self.backend)))
        return mean_of(renders)

    def held(self, view: TrainingView, rendered: Rendering, target: Tensor) -> Tensor:
        """The loss of one render against its target image [H, W], and against the depths that the view knows."""
        loss = self.against(rendered, target)
        return loss + self.hold(rendered, view.depth) if self.hold and view.depth else loss

    def against(self, rendered: Rendering, target: Tensor) -> Tensor:
        """The loss of one render against its target image [H, W]."""
        image = rendered.intensity[..., 0]
        if self.closeness:
            self.closeness.see(image.detach(), target)
        pixels = (image - target).abs().mean() / self.white
        alike = 1 - ssim(image, target, self.white)
        return (1 - self.ssim) * pixels + self.ssim * alike + self.solid * (1 - rendered.alpha).mean()


@dataclass(frozen=True)
class VariationTerm:
    """The image term at several instants `gap` planes apart, and the variation loss of Spike4DGS between them."""

    image: ImageTerm
    weight: float = 0.5
    instants: int = 3
    gap: int = 24

    def __call__(self, cloud: DynamicCloud, view: TrainingView, rng: np.random.Generator) -> Tensor:
        """The loss of instants that begin at a random plane."""
        instants = _instants(cloud, view, self.image.stride)
        gap = max(1, min(self.gap // self.image.stride, (len(instants) - 1) // (self.instants - 1)))
        first = int(rng.integers(max(1, len(instants) - gap * (self.instants - 1))))
        at = [int(instants[min(first + i * gap, len(instants) - 1)]) for i in range(self.instants)]
        pairs = [self.image.pair(cloud, view, plane) for plane in at]
        pixels = torch.stack([self.image.held(view, r, t) for r, t in pairs]).mean()
        rendered = torch.stack([r.intensity[..., 0] for r, _ in pairs])
        target = torch.stack([t for _, t in pairs])
        return pixels + self.weight * variation_loss(rendered, target) / self.image.white


@dataclass(frozen=True)
class SumTerm:
    """Several terms in one step, each at instants of its own."""

    terms: tuple[Term, ...]

    def __call__(self, cloud: DynamicCloud, view: TrainingView, rng: np.random.Generator) -> Tensor:
        """The sum of their losses."""
        return torch.stack([term(cloud, view, rng) for term in self.terms]).sum()


@dataclass(frozen=True)
class SpikeTerm:
    """Counts over a random window against the render integrated over it, in a part of the view that sees a mover.

    `size_px`: width and height of the part; None is the whole view.
    Windows are log-uniform between `shortest` and `longest` planes. The integral is a Gauss-Legendre quadrature of an
    instant for every `planes_a_node`, at most `most_nodes`; `cumulative` compares as many equal parts of the window.
    """

    image: ImageTerm
    norm: SpikeNorm
    shortest: int = 8
    longest: int = 33
    planes_a_node: int = 8
    most_nodes: int = 4
    size_px: tuple[int, int] | None = (160, 128)

    def __call__(self, cloud: DynamicCloud, view: TrainingView, rng: np.random.Generator) -> Tensor:
        """The loss of one window."""
        part = _part(view, self.size_px, rng)
        begin, end = _planes(cloud, view)
        low, high = (math.log(min(x, end - begin)) for x in (self.shortest, self.longest))
        window = round(math.exp(rng.uniform(low, high)))
        first = begin + int(rng.integers(end - begin - window + 1))
        nodes = min(self.most_nodes, math.ceil(window / self.planes_a_node))
        if self.norm == "cumulative":
            return self._running_totals(cloud, view, part, (first, window // nodes, nodes))
        seen = self.image.over(cloud, view, part.camera, (first, window, nodes))
        rate = torch.from_numpy(part.counts(view, first, first + window) / np.float32(window))
        good = torch.from_numpy(part.good)
        spikes = _norm(self.norm, seen.intensity[..., 0][good], rate[good], window)
        return spikes / self.image.white + self.image.solid * (1 - seen.alpha).mean()

    def _running_totals(
        self, cloud: DynamicCloud, view: TrainingView, part: Part, span: tuple[int, int, int]
    ) -> Tensor:
        first, length, parts = span
        starts = [first + i * length for i in range(parts)]
        renders = [self.image.over(cloud, view, part.camera, (start, length, 1)) for start in starts]
        counts = np.stack([part.counts(view, start, start + length) for start in starts])
        light, good = torch.stack([r.intensity[..., 0] for r in renders]), torch.from_numpy(part.good)
        loss = cumulative_loss(light[:, good], torch.from_numpy(counts)[:, good], length)
        alpha = torch.stack([r.alpha for r in renders])
        return loss / self.image.white + self.image.solid * (1 - alpha).mean()


def _planes(cloud: DynamicCloud, view: TrainingView) -> tuple[int, int]:
    """The planes [first, last) of the part of the clip that the motion is learnt from now."""
    planes, (low, high) = len(view.source.stream), cloud.motion.span()
    first = min(math.floor(low * planes), planes - 1)
    return first, min(max(math.ceil(high * planes), first + 1), planes)


def _instants(cloud: DynamicCloud, view: TrainingView, stride: int) -> NDArray[np.int64]:
    """The planes of that part whose images are targets; the nearest one where there is none."""
    instants, (first, last) = view.source.instants(stride), _planes(cloud, view)
    within = instants[(instants >= first) & (instants < last)]
    return within if len(within) else instants[[np.abs(2 * instants + 1 - first - last).argmin()]]


@dataclass(frozen=True, eq=False)
class Part:
    """A rectangle of a view: its camera, where it begins, and its pixels [H, W] that are not stuck."""

    camera: Camera
    top: int
    left: int
    good: NDArray[np.bool_]

    def of(self, image: NDArray) -> NDArray:
        """The part of an image [H, W] of the whole view."""
        return image[self.top : self.top + self.camera.height, self.left : self.left + self.camera.width]

    def counts(self, view: TrainingView, first: int, last: int) -> NDArray[np.float32]:
        """Spikes [H, W] over planes [first, last)."""
        return self.of(view.source.stream.counts(first, last)).astype(np.float32)


def _part(view: TrainingView, size_px: tuple[int, int] | None, rng: np.random.Generator) -> Part:
    """A rectangle around a random pixel that moves (any pixel where none does)."""
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
    return Part(cut, top, left, ~view.source.background.stuck[top : top + height, left : left + width])


def _norm(name: SpikeNorm, light: Tensor, rate: Tensor, window: int) -> Tensor:
    if name == "l1":
        return (light - rate).abs().mean()
    if name == "l2":
        return (light - rate).square().mean()
    return robust_loss(light, rate, window)


def quadrature(nodes: int) -> tuple[list[float], list[float]]:
    """Gauss-Legendre places in (0, 1) and weights that sum to 1."""
    places, weights = np.polynomial.legendre.leggauss(nodes)
    return [float(p + 1) / 2 for p in places], [float(w) / 2 for w in weights]
