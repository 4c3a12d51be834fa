"""The C++ renderer as a torch function: float32 on the CPU, torch's number of threads."""

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from acquisition.native import Address
from reconstruction.errors import ReconstructionError
from reconstruction.native import Addresses, Int, Long, addresses, fits, kernel, threads
from reconstruction.rendering.result import GUARDS, Guards, Instantaneous, Rendering
from rigs.camera import Camera


class _Camera(ctypes.Structure):
    _fields_ = (("numbers", ctypes.c_double * 18), ("width", ctypes.c_int32), ("height", ctypes.c_int32))


class _Cloud(ctypes.Structure):
    _fields_ = (("tensors", ctypes.c_void_p * 5), ("count", ctypes.c_int64))


TILE = 16  # pixels a side, as the kernels have it
_Handle, _CloudPointer = ctypes.c_void_p, ctypes.POINTER(_Cloud)
_forward = kernel(
    "render_forward",
    ctypes.POINTER(_Camera),
    _CloudPointer,
    Addresses,
    Address,
    ctypes.c_char_p,
    Int,
    returns=ctypes.c_void_p,
)
_backward = kernel("render_backward", _Handle, _CloudPointer, Addresses, Addresses, Long, Int)
_release = kernel("render_release", _Handle)
_work = kernel("render_work", _Handle, ctypes.POINTER(ctypes.c_int64))
_attribute = kernel("render_attribute", _Handle, Address, Int, Address, Int)
MOST_MAPS = 8  # that `attribute` takes at once


class _Frame:
    """Holds what the kernels keep between forward and backward, and gives it back to the same build in the end."""

    def __init__(self, handle: int) -> None:
        self.handle, self.backward, self.release = handle, _backward.bound(), _release.bound()

    def __del__(self) -> None:
        self.release(self.handle)


def _cloud(tensors: tuple[Tensor, ...]) -> _Cloud:
    return _Cloud(addresses(*tensors), len(tensors[0]))


class _Seeing(NamedTuple):
    """The way a cloud is seen.

    `median` asks for the median depth. The first `given` Gaussians get no gradient. `wanted` has a byte for each tile
    of the picture, zero where it stays black; None where all are wanted.
    """

    camera: Camera
    guards: Guards = GUARDS
    median: bool = False
    given: int = 0
    wanted: bytes | None = None


def _rendered(way: _Seeing, cloud: tuple[Tensor, ...]) -> tuple[_Frame, Rendering]:
    """Return the frame and the images of five contiguous tensors, the last of them intensities [N]."""
    camera, guards, median = way.camera, way.guards, way.median
    blank = torch.empty if way.wanted is None else torch.zeros
    intensity, depth, alpha = (blank(camera.height, camera.width) for _ in range(3))
    middle = torch.empty(camera.height, camera.width) if median else None
    radii = torch.empty(len(cloud[0]), dtype=torch.int32)
    pose, lens = camera.cam_from_rig, (camera.fx, camera.fy, camera.cx, camera.cy)
    numbers = (*pose.rotation.ravel(), *pose.translation, *lens, *guards)
    seen_by = _Camera((ctypes.c_double * 18)(*numbers), camera.width, camera.height)
    images = addresses(intensity, depth, alpha, middle)
    frame = _Frame(_forward(seen_by, _cloud(cloud), images, radii, way.wanted, threads()))
    return frame, Rendering(intensity, depth, alpha, radii, middle)


class Work(NamedTuple):
    """The amount of work in a rendering: splats seen, their pairs with tiles, blocks and pixels that they touch."""

    splats: int
    in_tiles: int
    in_blocks: int  # of 4x4 pixels
    pixels: int  # that lost some of their light to the splat


def work_of(gaussians: Instantaneous, camera: Camera, guards: Guards = GUARDS) -> Work:
    """Render the first channel as `render_native` does, and return how much work that was."""
    frame, _ = _rendered(_Seeing(camera, guards), (*gaussians[:4], gaussians.intensities[:, 0].contiguous()))
    counts = (ctypes.c_int64 * 4)()
    _work(frame.handle, counts)
    return Work(*counts)


def attribute(
    gaussians: Instantaneous, camera: Camera, maps_of: Callable[[Rendering], Tensor], guards: Guards = GUARDS
) -> tuple[Rendering, Tensor]:
    """Return the rendering of the first channel, and what each Gaussian has to do with maps over it [N, K].

    `maps_of` makes the maps [K, H, W] of the rendering, MOST_MAPS at most. The sums are over pixels, of the weight that
    the Gaussian has in one times the map's value there: of a map of ones, they are the pixels that it fills.
    """
    cloud = (*gaussians[:4], gaussians.intensities[:, 0])
    frame, seen = _rendered(_Seeing(camera, guards), tuple(t.detach().contiguous() for t in cloud))
    maps = maps_of(seen).contiguous()
    if maps.dtype != torch.float32 or maps.shape[1:] != (camera.height, camera.width) or len(maps) > MOST_MAPS:
        found, size = f"maps {tuple(maps.shape)} of {maps.dtype}", f"{camera.height}, {camera.width}"
        raise ReconstructionError(f"found {found}", f"[K, {size}], K at most {MOST_MAPS}, of torch.float32")
    sums = torch.zeros(len(gaussians.means), len(maps))
    _attribute(frame.handle, maps, len(maps), sums, threads())
    return seen, sums


class _Render(Function):
    @staticmethod
    def forward(ctx: Any, way: _Seeing, *cloud: Tensor) -> tuple[Tensor | None, ...]:
        cloud = tuple(t.contiguous() for t in cloud)
        ctx.frame, images = _rendered(way, cloud)
        ctx.given = way.given
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
        arguments = (_cloud(cloud), addresses(*wanted), addresses(*out), ctx.given, threads())
        ctx.frame.backward(ctx.frame.handle, *arguments)
        return (None, *out)


def render_native(
    gaussians: Instantaneous,
    camera: Camera,
    guards: Guards = GUARDS,
    *,
    median: bool = False,
    given: int = 0,
    only: Tensor | None = None,
) -> Rendering:
    """Render as `render_reference` does, in C++; each channel beyond the first costs another pass.

    The first `given` Gaussians get no gradient. `only` [H, W], bool: tiles that hold none of these pixels stay black.
    Raises ReconstructionError for tensors that are not float32 on the CPU, or without a channel.
    """
    means, *_, intensities = gaussians
    if not fits(means) or intensities.shape[1] == 0:
        raise ReconstructionError(
            f"found {intensities.shape[1]} channels of {means.dtype} on {means.device}",
            "float32 on the CPU",
            "use the reference backend",
        )
    geometry = (_Seeing(camera, guards, median, given, None if only is None else _tiles(only)), *gaussians[:4])
    if intensities.shape[1] == 1:
        intensity, *others = _Render.apply(*geometry, intensities.squeeze(-1))
        return Rendering(intensity[..., None], *others)
    passes = [_Render.apply(*geometry, channel) for channel in intensities.unbind(-1)]
    return Rendering(torch.stack([intensity for intensity, *_ in passes], -1), *passes[0][1:])


def _tiles(pixels: Tensor) -> bytes:
    """Return a byte for each tile [H / TILE, W / TILE], rounded up: whether it holds any of the pixels [H, W]."""
    grown = torch.nn.functional.pad(pixels, (0, -pixels.shape[1] % TILE, 0, -pixels.shape[0] % TILE))
    return grown.unflatten(0, (-1, TILE)).unflatten(2, (-1, TILE)).any(3).any(1).numpy().tobytes()
