"""Compares renders with images: of one instant, or how they change over a few. Letters: H rows, W columns."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.losses.picture import PictureLoss, Target, picture_loss
from reconstruction.losses.variation import variation_loss
from reconstruction.rendering.render import Backend, render
from reconstruction.rendering.result import Rendering
from reconstruction.training.closeness import Closeness
from reconstruction.training.draws import Draws
from reconstruction.training.exposure import Exposure, mean_of
from reconstruction.training.view import TrainingView
from rigs.camera import Camera
from rigs.clock import RigClock


@dataclass(frozen=True)
class ImageTerm:
    """Compares the render of one instant with its target image: L1 and SSIM.

    `white`: data range, spikes per tick. `stride`: planes between the instants that have a target image, so that these
    can be kept. `ssim`: share of SSIM in the loss. `solid`: weight of light that passes through everything, so that
    dark texture is not taken for a hole. `closeness` is told of every image compared. `hold` keeps renders to depths
    that the view knows. `exposure` knows which planes an image is the mean of; without it, an image shows an instant.
    Images take the float type that `backend` renders the Gaussians in.
    """

    clock: RigClock
    white: float
    stride: int = 1
    ssim: float = 0.2
    solid: float = 0.02
    closeness: Closeness | None = None
    backend: Backend = "native"
    hold: float = 0.0
    exposure: Exposure | None = None

    def __call__(self, cloud: DynamicCloud, view: TrainingView, draws: Draws) -> Tensor:
        """Return the loss at the next plane."""
        instants = target_planes(cloud, view, self.stride)
        plane = int(instants[draws.place(len(instants))])
        return self.held(view, *self.pair(cloud, view, plane))

    def pair(self, cloud: DynamicCloud, view: TrainingView, plane: int) -> tuple[Rendering, Tensor]:
        """Return the render at `plane` and its target image [H, W]."""
        exposure, source = self.exposure, view.source
        span = (*source.exposed(plane, exposure.planes), exposure.nodes) if exposure else (plane, 1, 1)
        rendered = self.over(cloud, view, view.camera, span)
        target = view.picture(plane).to(rendered.intensity.dtype)
        return (rendered, target) if view.compared is None else alike_beyond(view.compared, rendered, target)

    def over(self, cloud: DynamicCloud, view: TrainingView, camera: Camera, span: tuple[float, int, int]) -> Rendering:
        """Render the mean of a span for `camera`: its begin and length in planes, and its number of instants."""
        first, length, nodes = span
        options = {"backend": self.backend, "dilation_px2": view.dilation(cloud.dilation_px2), "given": cloud.given}
        options |= {"only": view.compared if camera is view.camera else None}
        renders = []
        for node, weight in zip(*quadrature(nodes if cloud.changes else 1), strict=True):
            instant_s = self.clock.instant_s(first + length * node - 0.5)
            renders.append((weight, render(view.seen(cloud, instant_s), camera, **options)))
        return mean_of(renders)

    def held(self, view: TrainingView, rendered: Rendering, target: Tensor) -> Tensor:
        """Return the loss of one render against its target image [H, W] and the depths that the view knows."""
        light, depth, alpha = rendered.intensity[..., 0], *rendered[1:3]
        shared = 1.0 if view.covered is None else 1 / view.covered.float().mean().item()  # a mean over what was seen
        parts = PictureLoss(self.white, self.ssim, self.solid, self.hold)
        aim = Target(target, view.empty, view.inverse_depth if self.hold else None, shared)
        loss, mean_square = picture_loss((light, depth, alpha), aim, parts)
        if self.closeness:
            self.closeness.see(mean_square)
        return loss


@dataclass(frozen=True)
class ImageVariationTerm:
    """Compares renders with target images at `instants` instants `gap` planes apart, and their changes in between.

    `weight` is that of the variation loss beside the image term.
    """

    image: ImageTerm
    weight: float = 0.5
    instants: int = 3
    gap: int = 24

    def __call__(self, cloud: DynamicCloud, view: TrainingView, draws: Draws) -> Tensor:
        """Return the loss of instants that begin at the next plane."""
        instants = target_planes(cloud, view, self.image.stride)
        gap = max(1, min(self.gap // self.image.stride, (len(instants) - 1) // (self.instants - 1)))
        first = draws.place(max(1, len(instants) - gap * (self.instants - 1)))
        at = [int(instants[min(first + i * gap, len(instants) - 1)]) for i in range(self.instants)]
        pairs = [self.image.pair(cloud, view, plane) for plane in at]
        pixels = torch.stack([self.image.held(view, r, t) for r, t in pairs]).mean()
        rendered = torch.stack([r.intensity[..., 0] for r, _ in pairs])
        target = torch.stack([t for _, t in pairs])
        return pixels + self.weight * variation_loss(rendered, target) / self.image.white


def alike_beyond(covered: Tensor, rendered: Rendering, target: Tensor) -> tuple[Rendering, Tensor]:
    """Return a render and its target that are both black, and solid, where the camera has not `covered` [H, W] them."""
    light, alpha = rendered.intensity * covered[..., None], torch.where(covered, rendered.alpha, 1.0)
    return rendered._replace(intensity=light, alpha=alpha), target * covered


def learnt_planes(cloud: DynamicCloud, view: TrainingView) -> tuple[int, int]:
    """Return the planes [first, last) of the part of the clip that the motion is learnt from now."""
    planes, (low, high) = len(view.source.stream), cloud.motion.span()
    first = min(math.floor(low * planes), planes - 1)
    return first, min(max(math.ceil(high * planes), first + 1), planes)


def target_planes(cloud: DynamicCloud, view: TrainingView, stride: int) -> NDArray[np.int64]:
    """Return the planes of `learnt_planes` whose images are targets, or the nearest target where there is none."""
    instants, (first, last) = view.source.instants(stride), learnt_planes(cloud, view)
    within = instants[(instants >= first) & (instants < last)]
    return within if len(within) else instants[[np.abs(2 * instants + 1 - first - last).argmin()]]


def quadrature(nodes: int) -> tuple[list[float], list[float]]:
    """Return the Gauss-Legendre places in (0, 1) and their weights, which sum to 1."""
    places, weights = np.polynomial.legendre.leggauss(nodes)
    return [float(p + 1) / 2 for p in places], [float(w) / 2 for w in weights]
