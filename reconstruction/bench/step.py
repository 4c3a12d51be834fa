"""Times one optimisation step part by part: motion, renderer, loss, their gradients and Adam."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.motion_model import Instantaneous
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.losses.ssim import ssim
from reconstruction.rendering.render import Rendering, render
from reconstruction.scene_model import TimeSpan
from reconstruction.training.adam import Adam
from rigs.camera import Camera

MOVING = 0.4  # share of the Gaussians that move
WHITE = 0.6  # brightest light, in spikes per tick
INSTANT_S = 0.4
LOSS = "loss and its gradient"  # torch beside a kernel; every other part is a native call
PARTS = ("motion", "renderer", LOSS, "renderer gradient", "motion gradient", "Adam")


def dynamic_cloud(cloud: Instantaneous) -> DynamicCloud:
    """Return `cloud` with its last Gaussians moving a little, alive throughout, in a clip of one second."""
    still = round((1 - MOVING) * len(cloud.means))
    stored = cloud._replace(opacities=cloud.opacities.clamp(0.01, 0.99).logit())
    motion = PolynomialMotion.at_rest(torch.full((len(cloud.means) - still,), 0.5), duration=1.0)
    return DynamicCloud(
        GaussianCloud(*(t[:still].clone() for t in stored)),
        GaussianCloud(*(t[still:].clone() for t in stored)),
        motion,
        TimeSpan(0.0, 1.0),
    )


def loss_of(rendering: Rendering, target: Tensor) -> Tensor:
    """Return L1 and SSIM of a render against its target [H, W], weighted as in training."""
    image = rendering.intensity[..., 0]
    return 0.8 * (image - target).abs().mean() / WHITE + 0.2 * (1 - ssim(image, target, WHITE))


class Step:
    """A cloud, a view and its target, which can be stepped as a whole or in parts."""

    def __init__(self, cloud: Instantaneous, camera: Camera):
        self.cloud, self.camera = dynamic_cloud(cloud), camera
        generator = torch.Generator().manual_seed(0)
        self.target = WHITE * torch.rand(camera.height, camera.width, generator=generator)
        self.leaves = [t.requires_grad_(True) for _, t in self.cloud.tensors()]
        self.adam = Adam([{"params": [leaf], "lr": 1e-6} for leaf in self.leaves])

    def whole(self) -> None:
        """Take one step as training does."""
        self.adam.zero_grad(set_to_none=True)
        loss_of(render(self.cloud.at(INSTANT_S), self.camera), self.target).backward()
        self.adam.step()

    def parts(self) -> dict[str, float]:
        """Take one step and return the seconds of each part."""
        seconds: dict[str, float] = {}

        def timed(name: str, work: Callable[[], Any]) -> Any:
            started = time.perf_counter()
            done = work()
            seconds[name] = time.perf_counter() - started
            return done

        self.adam.zero_grad(set_to_none=True)
        now = timed("motion", lambda: self.cloud.at(INSTANT_S))
        cut = Instantaneous(*(t.detach().requires_grad_(True) for t in now))
        rendering = timed("renderer", lambda: render(cut, self.camera))
        image = replace(rendering, intensity=rendering.intensity.detach().requires_grad_(True))
        (slope,) = timed(LOSS, lambda: torch.autograd.grad(loss_of(image, self.target), image.intensity))
        slopes = timed("renderer gradient", lambda: torch.autograd.grad(rendering.intensity, cut, slope))
        timed("motion gradient", lambda: torch.autograd.backward(now, slopes))
        timed("Adam", self.adam.step)
        assert tuple(seconds) == PARTS
        return seconds

    def fastest(self, repeats: int) -> tuple[float, dict[str, float]]:
        """Return the least seconds of a whole step, and of each part, over `repeats` steps."""
        whole, parts = [], []
        for _ in range(repeats):
            started = time.perf_counter()
            self.whole()
            whole.append(time.perf_counter() - started)
            parts.append(self.parts())
        return min(whole), {name: min(p[name] for p in parts) for name in parts[0]}
