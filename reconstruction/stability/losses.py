"""Defines cases 20, 21 and 30: constant signals, equal images, numbers that are refused; and held depths."""

import math

import torch

from reconstruction.losses.picture import PictureLoss, Target, inverse_depth, picture_loss
from reconstruction.losses.variation import variation_loss
from reconstruction.rendering.render import NAMES, render
from reconstruction.rendering.result import Instantaneous
from reconstruction.stability.case import Case, Observation, refusal
from reconstruction.stability.probe import CAMERA, apart, gaussians_of, renderers, running


def _constant_signal(_: str) -> Observation:
    frames = torch.full((4, 9, 11), 0.3, requires_grad=True)
    loss = variation_loss(frames, torch.full((4, 9, 11), 0.2))
    loss.backward()
    assert frames.grad is not None
    slope = float(frames.grad.abs().max())
    return Observation(f"loss {loss.item():.0e}, gradient {slope:.0e}", abs(loss.item()), slope)


def _equal_images(_: str) -> Observation:
    error, slope = 0.0, 0.0
    flat, dark = torch.full((20, 24), 0.4), torch.zeros(20, 24)
    noise = torch.rand(20, 24, generator=torch.Generator().manual_seed(1))
    for image in (flat, dark, noise):
        leaf, whole = image.clone().requires_grad_(), torch.ones_like(image)
        loss = picture_loss((leaf, whole, whole), Target(image), PictureLoss(1.0, ssim=1.0))[0]
        loss.backward()
        assert leaf.grad is not None
        error = max(error, abs(float(loss.detach())))
        slope = max(slope, apart(leaf.grad, torch.zeros_like(image)))
    return Observation(f"flat, dark and noise: 1 to {error:.0e}, no gradient to {slope:.0e}", error, slope)


def _refused(renderer: str) -> Observation:
    device = "cuda" if renderer == "gsplat" else "cpu"
    taken = []
    for position, name in enumerate(NAMES):
        for value in (math.nan, math.inf, -math.inf):
            tensors = Instantaneous(*(t.clone().to(device) for t in gaussians_of(9)))
            tensors[position][4] = value
            taken += _taken(tensors, renderer, f"{value} in {name}", name)
    half = Instantaneous(*(t.to(device, torch.bfloat16) for t in gaussians_of(9)))
    taken += _taken(half, renderer, "bfloat16", "bfloat16")
    return Observation(f"taken: {', '.join(taken) or 'none of 16'}", float(len(taken)))


def _taken(tensors: Instantaneous, renderer: str, what: str, named: str) -> list[str]:
    with running(renderer) as backend:
        error = refusal(lambda: render(tensors, CAMERA, backend=backend))
    if error is None:
        return [what]
    return [] if named in error.found else [f"{what} ({error})"]


def _held_depth(_: str) -> Observation:
    """Hold depths from 1e-30 to 1e30 m: light on them, before, behind and nowhere; the last four are no depths."""
    known = torch.tensor([1e-30, 1e-3, 1.0, 1.0, 1.0, 1.0, 1e3, 1e30, math.nan, math.inf, 0.0, -1.0])
    shares = torch.tensor([1.0, 1.01, 1.0, 0.98, 1.3, 0.0, 1.0001, 1.02, 1.0, 1.0, 1.0, 1.0])
    alpha = torch.tensor([1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    depth = torch.where(known.isfinite(), known * shares, 2.0)
    loss = PictureLoss(1.0, ssim=0.0, solid=0.0, hold=0.2)
    found = []
    for dtype in (torch.float32, torch.float64):
        leaves = [t.to(dtype)[None].clone().requires_grad_() for t in (depth, alpha)]
        none, inverse = torch.zeros(1, len(known), dtype=dtype), inverse_depth(known[None].numpy()).to(dtype)
        held = picture_loss((none, leaves[0], leaves[1]), Target(none, inverse_depth=inverse), loss)[0]
        held.backward()
        # As a share of the depth it is the same everywhere; a metre is not.
        slopes = [leaf.grad.double() for leaf in leaves if leaf.grad is not None]
        found.append((held.detach().double(), slopes[0] * depth.double()[None].nan_to_num(), slopes[1]))
    off = (depth[:8].double() / known[:8].double() - alpha[:8].double()).abs()
    exact = loss.hold * off.clamp_max(loss.most).sum() / len(known)
    error = max(apart(held[None], exact[None]) for held, *_ in found)
    slope = max(apart(single, double) for single, double in zip(found[0][1:], found[1][1:], strict=True))
    return Observation(f"off by {error:.0e}, gradient by {slope:.0e}", error, slope)


CASES = (
    Case(None, "held depth, 1e-30 to 1e30 m", "the formula in float64", 1e-6, _held_depth),
    Case(20, "variation loss of constant light", "zero gradient", 0.0, _constant_signal),
    Case(21, "SSIM of equal images", "1, zero gradient", 1e-5, _equal_images),
    Case(30, "NaN, infinity, bfloat16", "refused by name", 0.0, _refused, renderers),
)
