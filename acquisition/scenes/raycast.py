"""Casts rays natively: the linear light, depth and object of every pixel of one camera at any instants.

Letters: n instants, P shapes, K textures of S x S texels, H rows, W columns, s samples a side of a pixel.
"""

import ctypes
import functools
import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acquisition.errors import AcquisitionError
from acquisition.native import Address, Kernel
from acquisition.scenes.light import EVEN, Uneven
from acquisition.scenes.view import Frames
from rigs.camera import Camera

Floats = NDArray[np.float64]
MOST_SHAPES = 64  # the native code keeps sets of shapes in one word


@dataclass(frozen=True, eq=False)
class SceneArrays:
    """A scene as arrays. A surface of albedo 1 that faces the sun emits `white` spikes per tick.

    With `mipmapped`, textures are averaged over the distance between rays, so that finer detail does not alias.
    Raises AcquisitionError for too many shapes, or for textures that are not square or not there.
    """

    shapes: Floats  # [P, 10], see bodies.Shape.row
    moving: NDArray[np.bool_]  # [P]
    ids: NDArray[np.int8]  # [P]
    textures: NDArray[np.float32]  # [K, S, S] in 0..1, periodic
    sun: Floats  # [3] unit, towards the sun
    white: float
    ambient: float  # fraction of `white` that needs no sun
    background: float  # spikes per tick where nothing is
    uneven: Uneven = EVEN
    mipmapped: bool = False

    def __post_init__(self) -> None:
        size = self.textures.shape[-1]
        if not 1 <= len(self.shapes) <= MOST_SHAPES:
            raise AcquisitionError(f"found {len(self.shapes)} shapes", f"1 to {MOST_SHAPES}", "use fewer shapes")
        if self.textures.ndim != 3 or self.textures.shape[1] != size or size & (size - 1):
            raise AcquisitionError(f"found textures {self.textures.shape}", "(K, S, S), S a power of two")
        if not 0 <= self.shapes[:, 4].min() <= self.shapes[:, 4].max() < len(self.textures):
            raise AcquisitionError(f"found a texture index outside the {len(self.textures)} textures of the scene")

    @functools.cached_property
    def pyramid(self) -> tuple[NDArray[np.float32], ...]:
        """The textures [K, S, S]; where `mipmapped`, then means of 2 x 2 texels of each level down to [K, 2, 2]."""
        levels = [np.ascontiguousarray(self.textures, dtype=np.float32)]
        while self.mipmapped and levels[-1].shape[1] > 2:
            count, size, _ = levels[-1].shape
            fine = levels[-1].reshape(count, size // 2, 2, size // 2, 2)
            levels.append(fine.mean(axis=(2, 4), dtype=np.float64).astype(np.float32))
        return tuple(levels)


class _Scene(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("shapes", "moving", "ids", "textures")),
        ("sun", ctypes.c_double * 3),
        *((name, ctypes.c_double) for name in ("white", "ambient", "background")),
        ("slope", ctypes.c_double * 3),
        *((name, ctypes.c_double) for name in ("offset", "least")),
        *((name, ctypes.c_int32) for name in ("count", "texture_size", "texture_count", "levels")),
    ]


class _View(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double) for name in ("fx", "fy", "cx", "cy")),
        ("rotation", ctypes.c_double * 9),
        ("center", ctypes.c_double * 3),
        *((name, ctypes.c_int32) for name in ("width", "height", "samples", "threads")),
        *((name, ctypes.c_void_p) for name in ("slopes", "middles")),
        ("reach", ctypes.c_double),
    ]


class _Still(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("depth", "lit", "unlit", "foot", "middle", "mean", "middle_id")]


_SEEN = (ctypes.POINTER(_Scene), ctypes.POINTER(_View))
_raycast_still = Kernel("acquisition", "raycast_still", *_SEEN, Address, Address, ctypes.POINTER(_Still))
_raycast_frames = Kernel(
    "acquisition", "raycast_frames", *_SEEN, ctypes.POINTER(_Still), ctypes.c_int64, *(Address,) * 6
)


class Raycaster:
    """One camera in one scene: traces what stands still once, then only what moves.

    `placement` are world_from_shape of the shapes, rotations [P, 3, 3] and positions [P, 3] in metres; those of still
    shapes hold for good. A pixel is the mean of `samples` x `samples` rays; `threads` 0 takes every core.
    `still_intensity` [H, W] is the light of still shapes alone, in spikes per tick, at a gain of 1.
    A lens bends each ray exactly. Raises AcquisitionError for one that folds inside the picture.
    """

    def __init__(
        self, scene: SceneArrays, camera: Camera, placement: tuple[Floats, Floats], *, samples: int, threads: int = 0
    ):
        if samples < 1:
            raise AcquisitionError(f"found {samples} samples a side of a pixel", "at least 1")
        self._size = (camera.height, camera.width)
        self._scene, self._kept = _native_scene(scene)
        self._view, self._rays = _native_view(camera, samples, threads)
        sampled = (*self._size, samples * samples)
        shapes = (sampled, sampled, sampled, (*self._size, 3), self._size)
        self.still_intensity = np.empty(self._size, np.float32)
        last = self.still_intensity, np.empty(self._size, np.int8)
        self._still_arrays = [*(np.empty(shape) for shape in shapes), *last]
        self._still = _Still(*(a.ctypes.data for a in self._still_arrays))
        rotations, positions = self._checked(placement[0][None], placement[1][None])
        _raycast_still(self._scene, self._view, rotations, positions, self._still)

    def intensity(self, rotations: Floats, positions: Floats, gains: Floats) -> NDArray[np.float32]:
        """Trace light alone [n, H, W] with the shapes at `rotations` [n, P, 3, 3] and `positions` [n, P, 3] in metres.

        The light of each instant is multiplied by its `gains` [n].
        """
        intensity = np.empty((len(rotations), *self._size), dtype=np.float32)
        self._trace(rotations, positions, gains, intensity, None, None)
        return intensity

    def frames(self, rotations: Floats, positions: Floats, gains: Floats) -> Frames:
        """Trace light, depth and objects; the arguments are those of `intensity`."""
        shape = (len(rotations), *self._size)
        frames = Frames(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.int8))
        self._trace(rotations, positions, gains, frames.intensity, frames.depth, frames.ids)
        return frames

    def _trace(self, rotations: Floats, positions: Floats, gains: Floats, *images: NDArray | None) -> None:
        rotations, positions = self._checked(rotations, positions)
        if gains.shape != rotations.shape[:1]:
            raise AcquisitionError(f"found gains {gains.shape}", f"one for each of {len(rotations)} instants")
        poses = (rotations, positions, np.ascontiguousarray(gains, dtype=np.float64))
        _raycast_frames(self._scene, self._view, self._still, len(rotations), *poses, *images)

    def _checked(self, rotations: Floats, positions: Floats) -> tuple[Floats, Floats]:
        count = (len(rotations), self._scene.count)
        if rotations.shape != (*count, 3, 3) or positions.shape != (*count, 3):
            raise AcquisitionError(f"found poses {rotations.shape} and {positions.shape}", f"{count} of them")
        return np.ascontiguousarray(rotations, np.float64), np.ascontiguousarray(positions, np.float64)


def _native_scene(scene: SceneArrays) -> tuple[_Scene, list[NDArray]]:
    """Return the scene as the kernels take it, and the arrays whose addresses it holds, which must be kept."""
    levels = np.concatenate([level.ravel() for level in scene.pyramid])
    typed = (scene.shapes, np.float64), (scene.moving, np.uint8), (scene.ids, np.int8), (levels, np.float32)
    kept = [np.ascontiguousarray(array, dtype=kind) for array, kind in typed]
    return _Scene(
        *(array.ctypes.data for array in kept),
        tuple(scene.sun),
        *(scene.white, scene.ambient, scene.background),
        scene.uneven.slope,
        *(scene.uneven.offset, scene.uneven.least),
        *(len(scene.shapes), scene.textures.shape[1], len(scene.textures), len(scene.pyramid)),
    ), kept


def _native_view(camera: Camera, samples: int, threads: int) -> tuple[_View, tuple[Floats, ...]]:
    """Return the camera as the kernels take it, and the rays of a lens that bends, which must be kept."""
    lens, pose = (camera.fx, camera.fy, camera.cx, camera.cy), camera.cam_from_rig
    size = (camera.width, camera.height, samples, threads or len(os.sched_getaffinity(0)))
    view = _View(*lens, tuple(pose.rotation.ravel()), tuple(pose.center), *size)
    if not camera.bends:
        return view, ()
    middles, *corners = (_slopes(camera, ((x, y),)) for x, y in ((0.5, 0.5), (0, 0), (0, 1), (1, 0), (1, 1)))
    rows, columns = np.divmod(np.arange(samples * samples), samples)
    slopes = _slopes(camera, np.stack([columns + 0.5, rows + 0.5], axis=1) / samples)
    if not all(np.isfinite(rays).all() for rays in (slopes, middles, *corners)):
        raise AcquisitionError("found a lens that folds inside the picture", "one ray a pixel", where=camera.id)
    view.slopes, view.middles = slopes.ctypes.data, middles.ctypes.data
    view.reach = float(max(np.linalg.norm(corner - middles, axis=-1).max() for corner in corners))
    return view, (slopes, middles)


def _slopes(camera: Camera, parts: ArrayLike) -> Floats:
    """Return where `parts` [S, 2] of every pixel, in pixels from its first corner, look [H, W, S, 2]."""
    rows, columns = np.indices((camera.height, camera.width), dtype=np.float64)
    places = np.stack([columns, rows], axis=-1)[:, :, None] + np.asarray(parts)
    return np.ascontiguousarray(camera.slopes(places.reshape(-1, 2))).reshape(places.shape)
