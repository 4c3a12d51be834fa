"""Fits a dynamic cloud to target images at random instants of random views."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.images.composite import CompositeSource
from reconstruction.images.estimate import shrunk
from reconstruction.losses.ssim import ssim
from reconstruction.losses.variation import variation_loss
from reconstruction.rendering.render import Rendering, render
from rigs.camera import Camera
from rigs.clock import RigClock


@dataclass(frozen=True, eq=False)
class TrainingView:
    """A camera and the images it should see."""

    camera: Camera
    source: CompositeSource


@dataclass(frozen=True)
class Rates:
    """Adam's learning rates at the start; `means` and `velocities` fall to `final` of that, the others to a third.

    Lengths are in units of the scene (the mean distance from the cameras to the points).
    """

    means: float = 1e-3
    velocities: float = 3e-3
    quats_wxyz: float = 1e-2
    log_scales: float = 4e-2
    opacity_logits: float = 6e-2
    intensities: float = 8e-3
    instants: float = 4e-3
    log_durations: float = 2e-2
    final: float = 0.05


@dataclass(frozen=True)
class TrainerSettings:
    """`half_until`: share of the training at half resolution; `variation_every`: steps between variation losses.

    `solid_weight` is against light that passes through everything: dark texture is not a hole.
    """

    variation: bool
    rates: Rates = field(default_factory=Rates)
    ssim_weight: float = 0.2
    solid_weight: float = 0.02
    half_until: float = 0.1
    variation_every: int = 4
    variation_weight: float = 0.5
    variation_instants: int = 3
    variation_gap: int = 24  # planes between the instants of one variation loss
    white: float = 0.6  # data range of SSIM, spikes per tick


class Trainer:
    """One optimisation; `state` and `restore` carry it over a kill exactly (same steps, same draws)."""

    def __init__(
        self,
        cloud: DynamicCloud,
        views: Sequence[TrainingView],
        settings: TrainerSettings,
        clock: RigClock,
        seed: int,
    ):
        self.cloud = cloud
        self.views = views
        self.settings = settings
        self.clock = clock
        self.rng = np.random.default_rng(seed)
        self.steps = 0
        self.optimizer = _optimizer(cloud, views, settings.rates)

    def step(self, done: float) -> float:
        """One update; `done` in [0, 1] is how much of the training lies behind and sets rates and resolution."""
        self._anneal(done)
        shrink = 2 if done < self.settings.half_until else 1
        view = self.views[int(self.rng.integers(len(self.views)))]
        self.optimizer.zero_grad(set_to_none=True)
        if self.settings.variation and self.steps % self.settings.variation_every == self.settings.variation_every - 1:
            loss = self._variation(view, shrink)
        else:
            loss = self._pixels(view, int(self.rng.integers(len(view.source.stream))), shrink)
        loss.backward()
        self.optimizer.step()
        self.steps += 1
        return float(loss.detach())

    def _pixels(self, view: TrainingView, plane: int, shrink: int) -> Tensor:
        rendered, target = self._pair(view, plane, shrink)
        return self._photometric(rendered, target)

    def _photometric(self, rendered: Rendering, target: Tensor) -> Tensor:
        image, weight, white = rendered.intensity[..., 0], self.settings.ssim_weight, self.settings.white
        pixels = (1 - weight) * (image - target).abs().mean() / white + weight * (1 - ssim(image, target, white))
        return pixels + self.settings.solid_weight * (1 - rendered.alpha).mean()

    def _variation(self, view: TrainingView, shrink: int) -> Tensor:
        s, planes = self.settings, len(view.source.stream)
        gap = min(s.variation_gap, max(1, (planes - 1) // (s.variation_instants - 1)))
        first = int(self.rng.integers(max(1, planes - gap * (s.variation_instants - 1))))
        instants = [min(first + i * gap, planes - 1) for i in range(s.variation_instants)]
        pairs = [self._pair(view, plane, shrink) for plane in instants]
        pixels = torch.stack([self._photometric(r, t) for r, t in pairs]).mean()
        rendered = torch.stack([r.intensity[..., 0] for r, _ in pairs])
        target = torch.stack([t for _, t in pairs])
        return pixels + s.variation_weight * variation_loss(rendered, target) / s.white

    def _pair(self, view: TrainingView, plane: int, shrink: int) -> tuple[Rendering, Tensor]:
        camera, image = view.camera, view.source.at(plane)
        if shrink > 1:
            camera = camera.scaled(max(1, camera.width // shrink), max(1, camera.height // shrink))
            image = shrunk(image, camera)
        return render(self.cloud.at(self.clock.instant_s(plane)), camera), torch.from_numpy(image)

    def _anneal(self, done: float) -> None:
        for group in self.optimizer.param_groups:
            group["lr"] = group["start"] * group["end"] ** min(max(done, 0.0), 1.0)

    def state(self) -> dict:
        """Everything a resumed training needs, as tensors, numbers and strings."""
        return {
            "cloud": self.cloud.state(),
            "optimizer": self.optimizer.state_dict(),
            "rng": json.dumps(self.rng.bit_generator.state),
            "steps": self.steps,
        }

    def restore(self, state: dict) -> None:
        """Continue from `state` as if nothing had happened."""
        with torch.no_grad():
            for name, tensor in self.cloud.tensors():
                tensor.copy_(state["cloud"]["tensors"][name])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rng.bit_generator.state = json.loads(state["rng"])
        self.steps = state["steps"]


def train(
    trainer: Trainer,
    done: Callable[[], float],
    on_step: Callable[[float, float], None],
) -> None:
    """Step until `done()` reaches 1, at least once; `on_step(done, loss)` may raise to stop early."""
    fraction = done()
    while True:
        loss = trainer.step(fraction)
        fraction = done()
        on_step(fraction, loss)
        if fraction >= 1:
            return


def _optimizer(cloud: DynamicCloud, views: Sequence[TrainingView], rates: Rates) -> torch.optim.Adam:
    extent = _extent_m(cloud, views)
    groups = []
    for name, tensor in cloud.tensors():
        if tensor.numel() == 0:
            continue
        tensor.requires_grad_(True)
        kind = name.split(".")[1]
        length = kind in ("means", "velocities")
        start = getattr(rates, kind) * (extent if length else 1.0)
        groups.append({"params": [tensor], "lr": start, "start": start, "end": rates.final if length else 1 / 3})
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)


def _extent_m(cloud: DynamicCloud, views: Sequence[TrainingView]) -> float:
    """Mean distance from the cameras to the points: what a length is measured against."""
    centers = torch.tensor(np.stack([v.camera.center for v in views]), dtype=torch.float32)
    points = torch.cat([cloud.still.means, cloud.moving.means]).detach()
    return float((points.mean(dim=0) - centers).norm(dim=1).mean())
