"""The renderer on a CUDA device, by gsplat (1.5 or later), which is imported when it is first used.

gsplat's modes "antialiased" and "RGB+D" are this package's compensated opacity and accumulated depth. Two things
differ: its alpha ends at 0.999, ours at 0.99, and it leaves out the splat that takes the transmittance below 1e-4.
"""

import functools
import importlib
import importlib.util
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reconstruction.errors import BadRunError, ReconstructionError
from reconstruction.quaternions import unit
from reconstruction.rendering.reference import LOG_SCALE_MAX, LOG_SCALE_MIN
from reconstruction.rendering.result import GUARDS, Guards, Instantaneous, Rendering
from rigs.camera import Camera

DEVICE = "cuda"


def why_unavailable() -> str | None:
    """Say what gsplat lacks on this machine; None where it can render."""
    if importlib.util.find_spec("gsplat") is None:
        return "gsplat is not installed; pip install 'spike4dgs[gpu]'"
    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    return None


def expect_device() -> None:
    """Raise BadRunError, which says what was found, where gsplat cannot render on this machine."""
    missing = why_unavailable()
    if missing:
        raise BadRunError(f"found no GPU to train on ({missing})", "gsplat and a CUDA device", "take --device cpu")


@functools.cache
def _rasterization() -> Callable[..., tuple[Tensor, Tensor, dict[str, Any]]]:
    missing = why_unavailable()
    if missing:
        raise ReconstructionError(f"found no gsplat backend: {missing}", do="or use the native backend")
    return importlib.import_module("gsplat").rasterization


def render_gsplat(
    gaussians: Instantaneous, camera: Camera, guards: Guards = GUARDS, *, median: bool = False
) -> Rendering:
    """Render as `render_reference` does, by gsplat: float32 on a CUDA device.

    Raises ReconstructionError where gsplat or a CUDA device is missing, the tensors are elsewhere, or the median depth
    is asked for, which gsplat does not have.
    """
    if median:
        raise ReconstructionError("found a median depth asked of gsplat", "the native or the reference backend")
    rasterization = _rasterization()
    means, quats_wxyz, log_scales, opacities, intensities = gaussians
    if means.dtype != torch.float32 or means.device.type != DEVICE:
        raise ReconstructionError(f"found {means.dtype} on {means.device}", "float32 on a CUDA device")
    if len(means) == 0:
        nothing = intensities.new_zeros(camera.height, camera.width)
        dark = nothing[..., None].expand(-1, -1, intensities.shape[1]) + intensities.sum()
        return Rendering(dark, nothing, nothing, torch.zeros(0, dtype=torch.int32, device=means.device))
    cam_from_world = torch.eye(4, device=means.device)
    cam_from_world[:3, :3] = means.new_tensor(camera.cam_from_rig.rotation)
    cam_from_world[:3, 3] = means.new_tensor(camera.cam_from_rig.translation)
    colours, alphas, meta = rasterization(
        means=means,
        quats=unit(quats_wxyz),
        scales=log_scales.clamp(LOG_SCALE_MIN, LOG_SCALE_MAX).exp(),
        opacities=opacities,
        colors=intensities,
        viewmats=cam_from_world[None],
        Ks=means.new_tensor(camera.K)[None],
        width=camera.width,
        height=camera.height,
        near_plane=guards.near_m,
        eps2d=guards.dilation_px2,
        packed=False,
        render_mode="RGB+D",
        rasterize_mode="antialiased",
    )
    radii = meta["radii"][0]  # [N, 2] since 1.5, [N] before
    if radii.ndim == 2:
        radii = radii.amax(-1)
    return Rendering(colours[0, ..., :-1], colours[0, ..., -1], alphas[0, ..., 0], radii.int())
