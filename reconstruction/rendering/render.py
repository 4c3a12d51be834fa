"""The public renderer: Gaussians at one instant and a camera in, an image with depth and coverage out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.rendering.native import render_native
from reconstruction.rendering.pinhole import pinhole_of
from reconstruction.rendering.reference import render_reference
from rigs.camera import Camera

Backend = Literal["native", "reference"]
NEAR_M = 0.01


@dataclass(frozen=True)
class Rendering:
    """What a camera sees. The mean depth of what covers a pixel is `depth / alpha`."""

    intensity: Tensor  # [H, W, C] spikes per tick
    depth: Tensor  # [H, W] sum of weight times z, m
    alpha: Tensor  # [H, W] in [0, 1]
    radii: Tensor  # [N] int32 px, 0 where the Gaussian is not seen


NAMES = ("means", "quats_wxyz", "log_scales", "opacities", "intensities")


def _check(gaussians: tuple[Tensor, ...]) -> None:
    means, opacities, n = gaussians[0], gaussians[3].detach(), len(gaussians[0])
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, *gaussians[4].shape[1:2]))
    for name, shape, tensor in zip(NAMES, shapes, gaussians, strict=True):
        if tensor.shape != shape:
            raise ReconstructionError(f"found {name} of shape {tuple(tensor.shape)}, expected {shape}")
        if tensor.dtype != means.dtype or tensor.device != means.device:
            found, expected = f"{tensor.dtype} on {tensor.device}", f"{means.dtype} on {means.device}"
            raise ReconstructionError(f"found {name} as {found}, expected {expected} as the means are")
        # x - x is 0 for finite numbers only, and a sum of zeros is much faster than isfinite.
        if (tensor.detach() - tensor.detach()).sum() != 0:
            raise ReconstructionError(f"found NaN or infinity in {name}, expected finite numbers")
    if n and not (opacities.amin() >= 0 and opacities.amax() <= 1):
        raise ReconstructionError("found opacities beyond [0, 1], expected them after the sigmoid")


def render(
    gaussians: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    camera: Camera,
    *,
    backend: Backend = "native",
    near_m: float = NEAR_M,
    background: Tensor | float | None = None,
) -> Rendering:
    """Render N Gaussians as they are at one instant; differentiable in all of them.

    `gaussians`: means [N, 3] m in the rig frame, quats_wxyz [N, 4] of any length, log_scales [N, 3] (log m), opacities
    [N] in [0, 1], intensities [N, C] in spikes per tick (native: C = 1, float32, CPU). `near_m`: nothing nearer is
    seen. `background`: the intensity behind everything, one number or [H, W, C]; none is black.
    Raises ReconstructionError for shapes that do not fit, NaN or infinity, or a camera with lens distortion.
    """
    _check(gaussians)
    means, _, _, _, intensities = gaussians
    on_cpu = means.dtype == torch.float32 and means.device.type == "cpu"
    if backend == "native" and not (on_cpu and intensities.shape[1] == 1):
        raise ReconstructionError(
            f"found {intensities.shape[1]} channels of {means.dtype} on {means.device}, "
            "expected one channel of float32 on the CPU; use the reference backend"
        )
    renderer = render_native if backend == "native" else render_reference
    intensity, depth, alpha, radii = renderer(*gaussians, pinhole_of(camera, near_m))
    if background is not None:
        intensity = intensity + (1 - alpha)[..., None] * background
    return Rendering(intensity, depth, alpha, radii)
