"""Cases 20, 21 and 30 of the catalogue: constant signals, equal images, and numbers that are refused."""

import math

import torch

from reconstruction.errors import ReconstructionError
from reconstruction.losses.ssim import ssim_map
from reconstruction.losses.variation import variation_loss
from reconstruction.rendering.render import NAMES, Backend, render
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.probe import CAMERA, gaussians_of


def _constant_signal(_: Backend) -> Observation:
    frames = torch.full((4, 9, 11), 0.3, requires_grad=True)
    loss = variation_loss(frames, torch.full((4, 9, 11), 0.2))
    loss.backward()
    assert frames.grad is not None
    slope = float(frames.grad.abs().max())
    return f"loss {loss.item():.0e}, gradient {slope:.0e}", slope if math.isfinite(slope) else math.inf


def _equal_images(_: Backend) -> Observation:
    error = 0.0
    flat, dark = torch.full((20, 24), 0.4), torch.zeros(20, 24)
    noise = torch.rand(20, 24, generator=torch.Generator().manual_seed(1))
    for image in (flat, dark, noise):
        leaf = image.clone().requires_grad_()
        similarity = ssim_map(leaf, image, 1.0)
        similarity.mean().backward()
        assert leaf.grad is not None
        worst = max(float((similarity.detach() - 1).abs().max()), float(leaf.grad.abs().max()))
        error = max(error, worst if math.isfinite(worst) else math.inf)
    return f"flat, dark and noise: 1 and no gradient to {error:.0e}", error


def _refused(backend: Backend) -> Observation:
    device = "cuda" if backend == "gsplat" else "cpu"
    taken = []
    for position, name in enumerate(NAMES):
        for value in (math.nan, math.inf, -math.inf):
            tensors = [t.clone().to(device) for t in gaussians_of(9)]
            tensors[position][4] = value
            taken += _taken(tensors, backend, f"{value} in {name}", name)
    half = [t.to(device, torch.bfloat16) for t in gaussians_of(9)]
    taken += _taken(half, backend, "bfloat16", "bfloat16")
    return f"taken: {', '.join(taken) or 'none of 16'}", float(len(taken))


def _taken(tensors: list[torch.Tensor], backend: Backend, what: str, named: str) -> list[str]:
    try:
        render(tuple(tensors), CAMERA, backend=backend)  # type: ignore[arg-type]
    except ReconstructionError as error:
        return [] if named in str(error) else [f"{what} ({error})"]
    return [what]


CASES = (
    Case(20, "variation loss of constant light", "zero gradient", 0.0, _constant_signal, renders=False),
    Case(21, "SSIM of equal images", "1, zero gradient", 1e-5, _equal_images, renders=False),
    Case(30, "NaN, infinity, bfloat16", "refused by name", 0.0, _refused),
)
