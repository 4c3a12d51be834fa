"""The public renderer: Gaussians at one instant and a camera in, an image with depth and coverage out."""

import math
from typing import Literal

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.rendering.gsplat_backend import render_gsplat
from reconstruction.rendering.native import render_native
from reconstruction.rendering.reference import render_reference
from reconstruction.rendering.result import GUARDS, Guards, Instantaneous, Rendering
from rigs.camera import Camera

Backend = Literal["native", "reference", "gsplat"]
RENDERERS = {"native": render_native, "reference": render_reference, "gsplat": render_gsplat}
NAMES = Instantaneous._fields


def _check(gaussians: Instantaneous) -> None:
    means, opacities, n = gaussians.means, gaussians.opacities.detach(), len(gaussians.means)
    if means.dtype not in (torch.float32, torch.float64):
        raise ReconstructionError(f"found means of {means.dtype}", "float32 or float64: covariances need them")
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, *gaussians.intensities.shape[1:2]))
    for name, shape, tensor in zip(NAMES, shapes, gaussians, strict=True):
        if tensor.shape != shape:
            raise ReconstructionError(f"found {name} of shape {tuple(tensor.shape)}", str(shape))
        if tensor.dtype != means.dtype or tensor.device != means.device:
            found, expected = f"{tensor.dtype} on {tensor.device}", f"{means.dtype} on {means.device}"
            raise ReconstructionError(f"found {name} as {found}", f"{expected} as the means are")
        # A sum is finite where all are, unless it overflows, and much faster than isfinite.
        if not math.isfinite(tensor.detach().sum()) and not tensor.isfinite().all():
            raise ReconstructionError(f"found NaN or infinity in {name}", "finite numbers")
    least, most = opacities.aminmax() if n else (0, 1)
    if not (least >= 0 and most <= 1):
        raise ReconstructionError("found opacities beyond [0, 1]", "them after the sigmoid")


def render(
    gaussians: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
    camera: Camera,
    *,
    backend: Backend = "native",
    near_m: float = GUARDS.near_m,
    dilation_px2: float = GUARDS.dilation_px2,
    background: Tensor | float | None = None,
    median: bool = False,
    given: int = 0,
    only: Tensor | None = None,
) -> Rendering:
    """Render N Gaussians, the five tensors of an `Instantaneous`; differentiable in all of them.

    `backend`: native (float32 on the CPU), reference (float32 or float64, anywhere), gsplat (float32 on a CUDA device).
    `near_m` and `dilation_px2` are those of `result.Guards`. `background`: the intensity behind everything, one number
    or [H, W, C], black if None. `median` asks for the median depth too, which gsplat does not have. The first `given`
    Gaussians get no gradient. `only` [H, W], bool: beyond these pixels the picture may be black. Raises
    ReconstructionError for shapes that do not fit, NaN or infinity, or a lens that distorts.
    """
    now = Instantaneous(*gaussians)
    _check(now)
    if camera.bends:
        raise ReconstructionError("found lens distortion", "a pinhole", "render its view and bend it", where=camera.id)
    if not near_m > 0:
        raise ReconstructionError(f"found the near plane at {near_m} m", "a positive depth")
    if not (math.isfinite(dilation_px2) and dilation_px2 > 0):
        raise ReconstructionError(f"found a dilation of {dilation_px2} px^2", "a positive number")
    guards = Guards(near_m, dilation_px2)
    if backend == "native":
        seen = render_native(now, camera, guards, median=median, given=given, only=only)
    else:
        held = Instantaneous(*(torch.cat([t[:given].detach(), t[given:]]) for t in now)) if given else now
        seen = RENDERERS[backend](held, camera, guards, median=median)
    if background is None:
        return seen
    return seen._replace(intensity=seen.intensity + (1 - seen.alpha)[..., None] * background)
