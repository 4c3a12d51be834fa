"""A small scene rendered by a backend with its gradients, and how far that is from the float64 reference."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from reconstruction.rendering.gsplat_backend import why_unavailable
from reconstruction.rendering.render import Backend, Rendering, render
from rigs.camera import Camera
from rigs.transform import Transform

CAMERA = Camera("cam11", 40, 28, 60.0, 60.0, 20.0, 14.0, Transform.identity())
Gaussians = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class Probe:
    """What came out, on the CPU in float64: the rendering and the gradients of the five tensors."""

    rendering: Rendering
    gradients: tuple[Tensor, ...]

    @property
    def sound(self) -> bool:
        """Whether everything is finite and the coverage within [0, 1]."""
        r = self.rendering
        finite = all(bool(t.isfinite().all()) for t in (r.intensity, r.depth, r.alpha, *self.gradients))
        return finite and float(r.alpha.min()) >= 0 and float(r.alpha.max()) <= 1


def backends() -> tuple[Backend, ...]:
    """The backends this machine can run."""
    return ("reference", "native") if why_unavailable() else ("reference", "native", "gsplat")


def gaussians_of(n: int = 1, **changes: Tensor) -> Gaussians:
    """N equal Gaussians at a pixel's centre, two metres away, 3 px wide; `changes` replace whole tensors."""
    tensors = {
        "means": torch.tensor([[0.5 / 30, 0.5 / 30, 2.0]]).repeat(n, 1),
        "quats_wxyz": torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        "log_scales": torch.full((n, 3), math.log(0.1)),
        "opacities": torch.full((n,), 0.7),
        "intensities": torch.ones(n, 1),
    }
    means, quats, log_scales, opacities, intensities = {**tensors, **changes}.values()
    return means, quats, log_scales, opacities, intensities


def probe(gaussians: Gaussians, backend: Backend, near_m: float = 0.01, background: float | None = None) -> Probe:
    """Render on `backend`, the reference in float64; gradients are of an uneven sum over all three images."""
    dtype = torch.float64 if backend == "reference" else torch.float32
    device = "cuda" if backend == "gsplat" else "cpu"
    leaves = tuple(t.detach().to(device, dtype).clone().requires_grad_() for t in gaussians)
    rendering = render(leaves, CAMERA, backend=backend, near_m=near_m, background=background)  # type: ignore[arg-type]
    # Not symmetric, or the gradients would cancel.
    weights = 0.2 + torch.rand(28, 40, generator=torch.Generator().manual_seed(3)).to(device, dtype)
    (weights * (rendering.intensity[..., 0] + 0.1 * rendering.depth + 0.3 * rendering.alpha)).sum().backward()
    images = (rendering.intensity, rendering.depth, rendering.alpha)
    intensity, depth, alpha = (t.detach().cpu().double() for t in images)
    return Probe(
        Rendering(intensity, depth, alpha, rendering.radii.cpu()),
        tuple((torch.zeros_like(t) if t.grad is None else t.grad).cpu().double() for t in leaves),
    )


def apart(found: Tensor, expected: Tensor) -> float:
    """Largest difference, over the larger of 1 and what was expected."""
    if found.numel() == 0:
        return 0.0
    worst = float((found - expected).abs().max()) / max(1.0, float(expected.abs().max()))
    return worst if math.isfinite(worst) else math.inf


def against_reference(gaussians: Gaussians, backend: Backend, **options: float) -> tuple[Probe, float]:
    """What `backend` made of it, and the worst of its images and a tenth of its gradients; infinite where unsound."""
    found = probe(gaussians, backend, **options)
    expected = found if backend == "reference" else probe(gaussians, "reference", **options)
    if not (found.sound and expected.sound):
        return found, math.inf
    images = max(
        apart(getattr(found.rendering, name), getattr(expected.rendering, name))
        for name in ("intensity", "depth", "alpha")
    )
    pairs = zip(found.gradients, expected.gradients, strict=True)
    slopes = max(apart(f, e) if e.numel() else 0.0 for f, e in pairs)
    return found, max(images, slopes / 10)
