"""The C++ renderer as a torch function: float32 on the CPU, torch's number of threads."""

from __future__ import annotations

import ctypes
import functools
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from reconstruction.errors import ReconstructionError
from reconstruction.native import library
from reconstruction.rendering.pinhole import Pinhole


class _Camera(ctypes.Structure):
    _fields_ = (("numbers", ctypes.c_double * 17), ("width", ctypes.c_int32), ("height", ctypes.c_int32))


class _Cloud(ctypes.Structure):
    _fields_ = (("tensors", ctypes.c_void_p * 5), ("count", ctypes.c_int64))


def _kernels() -> ctypes.CDLL:
    return _declared(library())


@functools.cache
def _declared(kernels: ctypes.CDLL) -> ctypes.CDLL:
    kernels.render_forward.restype = ctypes.c_void_p
    kernels.render_release.argtypes = (ctypes.c_void_p,)
    return kernels


class _Frame:
    """Holds what the kernels keep between forward and backward; gives it back when nobody can ask for it."""

    def __init__(self, kernels: ctypes.CDLL, pointer: int) -> None:
        self.kernels, self.pointer = kernels, pointer

    def __del__(self) -> None:
        self.kernels.render_release(self.pointer)


def _pointers(*tensors: Tensor | None) -> ctypes.Array:
    return (ctypes.c_void_p * len(tensors))(*(None if t is None else t.data_ptr() for t in tensors))


def _cloud(tensors: tuple[Tensor, ...]) -> _Cloud:
    return _Cloud(_pointers(*tensors), len(tensors[0]))


def _forward(
    camera: Pinhole, cloud: tuple[Tensor, ...], *, median: bool = False
) -> tuple[_Frame, tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]]:
    """The frame, and intensity, depth, alpha, radii and, if asked for, the median depth."""
    intensity, depth, alpha = (torch.empty(camera.height, camera.width) for _ in range(3))
    middle = torch.empty(camera.height, camera.width) if median else None
    radii = torch.empty(len(cloud[0]), dtype=torch.int32)
    numbers = (*camera.rotation, *camera.translation, *camera.focal, *camera.principal, camera.near_m)
    kernels = _kernels()
    pointer = kernels.render_forward(
        ctypes.byref(_Camera((ctypes.c_double * 17)(*numbers), camera.width, camera.height)),
        ctypes.byref(_cloud(cloud)),
        _pointers(intensity, depth, alpha, middle),
        ctypes.c_void_p(radii.data_ptr()),
        torch.get_num_threads(),
    )
    return _Frame(kernels, pointer), (intensity, depth, alpha, radii, middle)


class Work(NamedTuple):
    """How much a rendering was: `pixels` counts every pixel of every splat that took something of its light."""

    splats: int
    in_tiles: int
    in_blocks: int  # of 4x4 pixels
    pixels: int


def work_of(cloud: tuple[Tensor, ...], camera: Pinhole) -> Work:
    """Renders a cloud as `render_native` takes it, intensities [N], and counts."""
    frame, _ = _forward(camera, cloud)
    counts = (ctypes.c_int64 * 4)()
    frame.kernels.render_work(ctypes.c_void_p(frame.pointer), counts)
    return Work(*counts)


class _Render(Function):
    @staticmethod
    def forward(ctx: Any, camera: Pinhole, median: bool, *cloud: Tensor) -> tuple[Tensor | None, ...]:
        cloud = tuple(t.contiguous() for t in cloud)
        ctx.frame, images = _forward(camera, cloud, median=median)
        ctx.save_for_backward(*cloud)
        ctx.mark_non_differentiable(*(image for image in images[3:] if image is not None))
        ctx.set_materialize_grads(False)
        return images

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        cloud = ctx.saved_tensors
        wanted = [None if g is None else g.contiguous() for g in gradients[:3]]
        out = tuple(torch.zeros_like(t) for t in cloud)
        ctx.frame.kernels.render_backward(
            ctypes.c_void_p(ctx.frame.pointer),
            ctypes.byref(_cloud(cloud)),
            _pointers(*wanted),
            _pointers(*out),
            torch.get_num_threads(),
        )
        return (None, None, *out)


def render_native(
    means: Tensor,
    quats_wxyz: Tensor,
    log_scales: Tensor,
    opacities: Tensor,
    intensities: Tensor,
    camera: Pinhole,
    *,
    median: bool = False,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None]:
    """Native twin of `render_reference` for float32 on the CPU; each channel beyond the first is another pass.

    Raises ReconstructionError for tensors of another type or elsewhere.
    """
    if means.dtype != torch.float32 or means.device.type != "cpu" or intensities.shape[1] == 0:
        raise ReconstructionError(
            f"found {intensities.shape[1]} channels of {means.dtype} on {means.device}",
            "float32 on the CPU",
            "use the reference backend",
        )
    geometry = (camera, median, means, quats_wxyz, log_scales, opacities)
    if intensities.shape[1] == 1:
        intensity, *others = _Render.apply(*geometry, intensities.squeeze(-1))
        return intensity[..., None], *others
    passes = [_Render.apply(*geometry, channel) for channel in intensities.unbind(-1)]
    return torch.stack([intensity for intensity, *_ in passes], -1), *passes[0][1:]
