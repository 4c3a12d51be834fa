"""The C++ renderer as a torch function: float32 on the CPU, torch's number of threads."""

import ctypes
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from acquisition.native import Address
from reconstruction.errors import ReconstructionError
from reconstruction.native import Addresses, Int, addresses, fits, kernel, threads
from reconstruction.rendering.result import Instantaneous, Rendering
from rigs.camera import Camera


class _Camera(ctypes.Structure):
    _fields_ = (("numbers", ctypes.c_double * 17), ("width", ctypes.c_int32), ("height", ctypes.c_int32))


class _Cloud(ctypes.Structure):
    _fields_ = (("tensors", ctypes.c_void_p * 5), ("count", ctypes.c_int64))


_Handle, _CloudPointer = ctypes.c_void_p, ctypes.POINTER(_Cloud)
_forward = kernel(
    "render_forward", ctypes.POINTER(_Camera), _CloudPointer, Addresses, Address, Address, Int, returns=ctypes.c_void_p
)
_backward = kernel("render_backward", _Handle, _CloudPointer, Addresses, Addresses, Int)
_release = kernel("render_release", _Handle)
_work = kernel("render_work", _Handle, ctypes.POINTER(ctypes.c_int64))


class _Frame:
    """Holds what the kernels keep between forward and backward, and gives it back to the same build in the end."""

    def __init__(self, handle: int) -> None:
        self.handle, self.backward, self.release = handle, _backward.bound(), _release.bound()

    def __del__(self) -> None:
        self.release(self.handle)


def _cloud(tensors: tuple[Tensor, ...]) -> _Cloud:
    return _Cloud(addresses(*tensors), len(tensors[0]))


@dataclass(frozen=True, eq=False)
class _Asked:
    """The images that are asked for: which 4x4 blocks, as sixteen bits a tile (None: all), and whether a median."""

    camera: Camera
    near_m: float
    blocks: NDArray[np.uint16] | None = None
    median: bool = False

    def image(self) -> Tensor:
        size = self.camera.height, self.camera.width
        return torch.empty(*size) if self.blocks is None else torch.zeros(*size)


def _rendered(asked: _Asked, cloud: tuple[Tensor, ...]) -> tuple[_Frame, Rendering]:
    """Return the frame and the images of five contiguous tensors, the last of them intensities [N]."""
    camera = asked.camera
    intensity, depth, alpha = (asked.image() for _ in range(3))
    middle = asked.image() if asked.median else None
    radii = torch.empty(len(cloud[0]), dtype=torch.int32)
    pose, lens = camera.cam_from_rig, (camera.fx, camera.fy, camera.cx, camera.cy)
    numbers = (*pose.rotation.ravel(), *pose.translation, *lens, asked.near_m)
    seen_by = _Camera((ctypes.c_double * 17)(*numbers), camera.width, camera.height)
    images = addresses(intensity, depth, alpha, middle)
    frame = _Frame(_forward(seen_by, _cloud(cloud), images, radii, asked.blocks, threads()))
    return frame, Rendering(intensity, depth, alpha, radii, middle)


class Work(NamedTuple):
    """The amount of work in a rendering: splats seen, their pairs with tiles, blocks and pixels that they touch."""

    splats: int
    in_tiles: int
    in_blocks: int  # of 4x4 pixels
    pixels: int  # that lost some of their light to the splat


def work_of(gaussians: Instantaneous, camera: Camera, near_m: float) -> Work:
    """Render the first channel as `render_native` does, and return how much work that was."""
    frame, _ = _rendered(_Asked(camera, near_m), (*gaussians[:4], gaussians.intensities[:, 0].contiguous()))
    counts = (ctypes.c_int64 * 4)()
    _work(frame.handle, counts)
    return Work(*counts)


class _Render(Function):
    @staticmethod
    def forward(ctx: Any, asked: _Asked, *cloud: Tensor) -> tuple[Tensor | None, ...]:
        cloud = tuple(t.contiguous() for t in cloud)
        ctx.frame, images = _rendered(asked, cloud)
        ctx.save_for_backward(*cloud)
        ctx.mark_non_differentiable(*(image for image in images[3:] if image is not None))
        ctx.set_materialize_grads(False)
        return tuple(images)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        cloud = ctx.saved_tensors
        wanted = [None if g is None else g.contiguous() for g in gradients[:3]]
        out = tuple(torch.zeros_like(t) for t in cloud)
        given = (_cloud(cloud), addresses(*wanted), addresses(*out), threads())
        ctx.frame.backward(ctx.frame.handle, *given)
        return (None, *out)


def _tiles(wanted: Tensor) -> NDArray[np.uint16]:
    """Return the wanted blocks [h, w] as bits of tiles of 4x4 blocks, row by row."""
    down, across = (-(-size // 4) for size in wanted.shape)
    blocks = np.zeros((4 * down, 4 * across), dtype=np.uint16)
    blocks[: wanted.shape[0], : wanted.shape[1]] = wanted.numpy()
    bits = blocks.reshape(down, 4, across, 4) << np.arange(16, dtype=np.uint16).reshape(4, 1, 4)
    return np.ascontiguousarray(bits.sum(axis=(1, 3), dtype=np.uint16))


def render_native(
    gaussians: Instantaneous, camera: Camera, near_m: float, *, median: bool = False, wanted: Tensor | None = None
) -> Rendering:
    """Render as `render_reference` does, in C++; each channel beyond the first costs another pass.

    Raises ReconstructionError for tensors that are not float32 on the CPU, or without a channel.
    """
    means, *_, intensities = gaussians
    if not fits(means) or intensities.shape[1] == 0:
        raise ReconstructionError(
            f"found {intensities.shape[1]} channels of {means.dtype} on {means.device}",
            "float32 on the CPU",
            "use the reference backend",
        )
    geometry = (_Asked(camera, near_m, None if wanted is None else _tiles(wanted), median), *gaussians[:4])
    if intensities.shape[1] == 1:
        intensity, *others = _Render.apply(*geometry, intensities.squeeze(-1))
        return Rendering(intensity[..., None], *others)
    passes = [_Render.apply(*geometry, channel) for channel in intensities.unbind(-1)]
    return Rendering(torch.stack([intensity for intensity, *_ in passes], -1), *passes[0][1:])
