"""Renders a small scene with its gradients, and compares both with the reference in float64."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import NamedTuple, cast

import torch
from torch import Tensor

from acquisition.native import code_path, code_paths
from reconstruction.rendering.gsplat_backend import why_unavailable
from reconstruction.rendering.render import Backend, render
from reconstruction.rendering.result import Instantaneous, Rendering
from rigs.camera import Camera
from rigs.transform import Transform

CAMERA = Camera("cam11", 40, 28, 60.0, 60.0, 20.0, 14.0, Transform.identity())
BUILDS = ("v2", "v3", "v4")  # builds of the native kernels, on x86-64


@dataclass(frozen=True)
class Probe:
    """A rendering and the gradients of the five tensors, on the CPU in float64."""

    rendering: Rendering
    gradients: tuple[Tensor, ...]

    @property
    def sound(self) -> bool:
        """Return True where everything is finite and the coverage within [0, 1]."""
        alpha = self.rendering.alpha
        finite = all(bool(t.isfinite().all()) for t in (*self.rendering[:3], *self.gradients))
        return finite and float(alpha.min()) >= 0 and float(alpha.max()) <= 1


class Apart(NamedTuple):
    """The errors of values (images) and of gradients against those in float64; infinite where not finite."""

    images: float
    gradients: float

    @classmethod
    def of(
        cls, values: Iterable[Tensor], expected: Iterable[Tensor], slopes: Iterable[Tensor], steep: Iterable[Tensor]
    ) -> Apart:
        """Return the worst errors of values against those expected, and of slopes against those expected."""
        pairs = zip(values, expected, strict=True), zip(slopes, steep, strict=True)
        return cls(*(max((apart(*pair) for pair in found), default=0.0) for found in pairs))


def worst(errors: Iterable[Apart]) -> Apart:
    """Return the largest error of the images, and of the gradients."""
    return Apart(*(max(found) for found in zip(*errors, strict=True)))


def natives() -> tuple[str, ...]:
    """Return the native backend by each code path of this processor."""
    return tuple(f"native {name}" for name in code_paths())


def renderers() -> tuple[str, ...]:
    """Return the backends that this machine can run, all in float32."""
    return ("reference", *natives(), *(() if why_unavailable() else ("gsplat",)))


def omissions() -> list[str]:
    """Name the renderers that this machine lacks, and why."""
    lacking = [] if "plain" in code_paths() else [name for name in BUILDS if name not in code_paths()]
    left_out, reason = [f"native {name}: this processor lacks its instructions" for name in lacking], why_unavailable()
    return [*left_out, f"gsplat: {reason}"] if reason else left_out


@contextmanager
def running(renderer: str) -> Iterator[Backend]:
    """Take the code path of one of `renderers`, and yield the backend to ask for."""
    backend, _, path = renderer.partition(" ")
    with code_path(path) if path else nullcontext():
        yield cast(Backend, backend)


def gaussians_of(n: int = 1, **changes: Tensor) -> Instantaneous:
    """Return `n` equal Gaussians at a pixel's centre, two metres away, 3 px wide; `changes` replace whole tensors."""
    tensors = {
        "means": torch.tensor([[0.5 / 30, 0.5 / 30, 2.0]]).repeat(n, 1),
        "quats_wxyz": torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        "log_scales": torch.full((n, 3), math.log(0.1)),
        "opacities": torch.full((n,), 0.7),
        "intensities": torch.ones(n, 1),
    }
    return Instantaneous(**{**tensors, **changes})


def probe(
    gaussians: Instantaneous,
    renderer: str,
    near_m: float = 0.01,
    background: float | None = None,
    dtype: torch.dtype = torch.float32,
) -> Probe:
    """Render on `renderer`, and take the gradients of an uneven sum over all three images."""
    device = "cuda" if renderer == "gsplat" else "cpu"
    leaves = Instantaneous(*(t.detach().to(device, dtype).clone().requires_grad_() for t in gaussians))
    # Not symmetric, or the gradients would cancel.
    weights = 0.2 + torch.rand(28, 40, generator=torch.Generator().manual_seed(3)).to(device, dtype)
    with running(renderer) as backend:
        rendering = render(leaves, CAMERA, backend=backend, near_m=near_m, background=background)
        (weights * (rendering.intensity[..., 0] + 0.1 * rendering.depth + 0.3 * rendering.alpha)).sum().backward()
    intensity, depth, alpha = (t.detach().cpu().double() for t in rendering[:3])
    return Probe(Rendering(intensity, depth, alpha, rendering.radii.cpu()), slopes_of(leaves))


def slopes_of(leaves: Iterable[Tensor]) -> tuple[Tensor, ...]:
    """Return the gradients of the leaves on the CPU in float64; zeros where there are none."""
    return tuple((torch.zeros_like(t) if t.grad is None else t.grad).cpu().double() for t in leaves)


def apart(found: Tensor, expected: Tensor) -> float:
    """Return the largest difference, over the larger of 1 and the largest value expected."""
    if found.numel() == 0:
        return 0.0
    worst = float((found - expected).abs().max()) / max(1.0, float(expected.abs().max()))
    return worst if math.isfinite(worst) else math.inf


def against_reference(
    gaussians: Instantaneous, renderer: str, near_m: float = 0.01, background: float | None = None
) -> tuple[Probe, Apart]:
    """Return the probe of `renderer`, and its errors against the reference in float64."""
    found = probe(gaussians, renderer, near_m, background)
    expected = probe(gaussians, "reference", near_m, background, torch.float64)
    if not (found.sound and expected.sound):
        return found, Apart(math.inf, math.inf)
    return found, Apart.of(found.rendering[:3], expected.rendering[:3], found.gradients, expected.gradients)
