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


def _check(name: str, tensor: Tensor, shape: tuple[int, ...], like: Tensor) -> None:
    if tensor.shape != shape:
        raise ReconstructionError(f"found {name} of shape {tuple(tensor.shape)}, expected {shape}")
    if tensor.dtype != like.dtype or tensor.device != like.device:
        raise ReconstructionError(
            f"found {name} as {tensor.dtype} on {tensor.device}, expected {like.dtype} on {like.device} as the means"
        )
    bad = len(tensor) - int(torch.isfinite(tensor.detach()).reshape(len(tensor), -1).all(-1).sum())
    if bad:
        raise ReconstructionError(f"found NaN or infinity in {name} of {bad} Gaussians, expected finite numbers")


def render(
    means: Tensor,
    quats_wxyz: Tensor,
    log_scales: Tensor,
    opacities: Tensor,
    intensities: Tensor,
    camera: Camera,
    *,
    backend: Backend = "native",
    near_m: float = NEAR_M,
    background: Tensor | float | None = None,
) -> Rendering:
    """Render N Gaussians as they are at one instant; differentiable in all of them.

    means [N, 3] m in the rig frame, quats_wxyz [N, 4] of any length, log_scales [N, 3] (log m), opacities [N] in
    [0, 1], intensities [N, C] in spikes per tick (native: C = 1, float32, CPU). `near_m`: nothing nearer is seen.
    `background`: the intensity behind everything, one number or [H, W, C]; none is black.
    Raises ReconstructionError for shapes that do not fit, NaN or infinity, or a camera with lens distortion.
    """
    n, channels = len(means), intensities.shape[-1]
    shapes = {
        "means": (n, 3),
        "quats_wxyz": (n, 4),
        "log_scales": (n, 3),
        "opacities": (n,),
        "intensities": (n, channels),
    }
    cloud = (means, quats_wxyz, log_scales, opacities, intensities)
    for (name, shape), tensor in zip(shapes.items(), cloud, strict=True):
        _check(name, tensor, shape, means)
    if n and not (opacities.detach().amin() >= 0 and opacities.detach().amax() <= 1):
        raise ReconstructionError("found opacities beyond [0, 1], expected them after the sigmoid")
    if backend == "native" and (means.dtype != torch.float32 or means.device.type != "cpu" or channels != 1):
        raise ReconstructionError(
            f"found {channels} channels of {means.dtype} on {means.device}, expected one channel of float32 on the CPU; "
            "use the reference backend"
        )
    renderer = render_native if backend == "native" else render_reference
    intensity, depth, alpha, radii = renderer(*cloud, pinhole_of(camera, near_m))
    if background is not None:
        intensity = intensity + (1 - alpha)[..., None] * background
    return Rendering(intensity, depth, alpha, radii)
