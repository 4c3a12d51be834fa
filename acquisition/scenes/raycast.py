"""The native ray caster: linear light, depth and object of every pixel of one camera at any instants.

Letters: n instants, P shapes, K textures of S x S texels, H rows, W columns, s samples a side of a pixel.
"""

from __future__ import annotations

import ctypes
import functools
import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import AcquisitionError
from acquisition.native import load_library
from acquisition.scenes.light import EVEN, Uneven
from rigs.camera import Camera

Floats = NDArray[np.float64]
MOST_SHAPES = 64  # the native code keeps sets of shapes in one word


@dataclass(frozen=True)
class Frames:
    """What a camera sees at n instants, pixel (0, 0) at the top left.

    `intensity` float32 [n, H, W], linear, spikes per tick, mean over s x s rays a pixel; from the pixel's centre ray
    `depth` float32 [n, H, W] along z in metres (NaN where nothing is) and `ids` int8 [n, H, W] (0 where nothing is).
    """

    intensity: NDArray[np.float32]
    depth: NDArray[np.float32]
    ids: NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class Geometry:
    """A scene as arrays. A surface of albedo 1 that faces the sun emits `white` spikes per tick.

    With `mipmapped` textures are averaged as far as the rays lie apart, so that detail finer than those does not alias.
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
        """The textures [K, S, S], then, where `mipmapped`, means of 2 x 2 texels again and again down to [K, 2, 2]."""
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
    ]


class _Still(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("depth", "lit", "unlit", "foot", "middle", "mean", "middle_id")]


class Raycaster:
    """One camera in one scene: traces what stands still once, then only what moves.

    `rotations` [P, 3, 3] and `positions` [P, 3] are world_from_shape of the shapes; those of still shapes hold for
    good. `threads` 0 takes every core. Raises AcquisitionError for a camera with lens distortion.
    """

    def __init__(
        self, geometry: Geometry, camera: Camera, placement: tuple[Floats, Floats], *, samples: int, threads: int = 0
    ):
        if any(camera.distortion):
            raise AcquisitionError(
                f"found lens distortion {camera.distortion}", "none", "scenes are seen by pinholes", where=camera.id
            )
        if samples < 1:
            raise AcquisitionError(f"found {samples} samples a side of a pixel", "at least 1")
        self._size = (camera.height, camera.width)
        self._scene = self._native_scene(geometry)
        self._view = _View(
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            (ctypes.c_double * 9)(*camera.cam_from_rig.rotation.ravel()),
            (ctypes.c_double * 3)(*camera.center),
            camera.width,
            camera.height,
            samples,
            threads or len(os.sched_getaffinity(0)),
        )
        self._trace_still(placement, samples)

    def _native_scene(self, geometry: Geometry) -> _Scene:
        levels = np.concatenate([level.ravel() for level in geometry.pyramid])
        arrays = (geometry.shapes, geometry.moving, geometry.ids, levels)
        kinds = (np.float64, np.uint8, np.int8, np.float32)
        # Kept, for the structure holds their addresses only.
        self._arrays = [np.ascontiguousarray(a, dtype=kind) for a, kind in zip(arrays, kinds, strict=True)]
        return _Scene(
            *(a.ctypes.data for a in self._arrays),
            (ctypes.c_double * 3)(*geometry.sun),
            geometry.white,
            geometry.ambient,
            geometry.background,
            (ctypes.c_double * 3)(*geometry.uneven.slope),
            geometry.uneven.offset,
            geometry.uneven.least,
            len(geometry.shapes),
            geometry.textures.shape[1],
            len(geometry.textures),
            len(geometry.pyramid),
        )

    def _trace_still(self, placement: tuple[Floats, Floats], samples: int) -> None:
        sampled = (*self._size, samples * samples)
        self._still_arrays = [
            *(np.empty(sampled) for _ in range(3)),
            np.empty((*self._size, 3)),
            np.empty(self._size),
            np.empty(self._size, dtype=np.float32),
            np.empty(self._size, dtype=np.int8),
        ]
        self._still = _Still(*(a.ctypes.data for a in self._still_arrays))
        rotations, positions = self._checked(placement[0][None], placement[1][None])
        load_library("acquisition").raycast_still(
            ctypes.byref(self._scene),
            ctypes.byref(self._view),
            ctypes.c_void_p(rotations.ctypes.data),
            ctypes.c_void_p(positions.ctypes.data),
            ctypes.byref(self._still),
        )

    def _checked(self, rotations: Floats, positions: Floats) -> tuple[Floats, Floats]:
        count = (len(rotations), self._scene.count)
        if rotations.shape != (*count, 3, 3) or positions.shape != (*count, 3):
            raise AcquisitionError(f"found poses {rotations.shape} and {positions.shape}", f"{count} of them")
        return np.ascontiguousarray(rotations, np.float64), np.ascontiguousarray(positions, np.float64)

    @property
    def still_depth(self) -> Floats:
        """The depth of what stands still, of each pixel's centre ray in double precision [H, W]; NaN: nothing."""
        middle = self._still_arrays[4]
        return np.where(np.isfinite(middle), middle, np.nan)

    def intensity(self, rotations: Floats, positions: Floats, gains: Floats | None = None) -> NDArray[np.float32]:
        """Light alone [n, H, W] with the shapes at `rotations` [n, P, 3, 3], `positions` [n, P, 3].

        The light of each instant is times its `gains` [n]; None: 1.
        """
        intensity = np.empty((len(rotations), *self._size), dtype=np.float32)
        self._trace((rotations, positions, gains), intensity, None, None)
        return intensity

    def frames(self, rotations: Floats, positions: Floats, gains: Floats | None = None) -> Frames:
        """Light, depth and objects with the shapes at `rotations` [n, P, 3, 3], `positions` [n, P, 3]."""
        shape = (len(rotations), *self._size)
        frames = Frames(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.int8))
        self._trace((rotations, positions, gains), frames.intensity, frames.depth, frames.ids)
        return frames

    def _trace(
        self,
        placements: tuple[Floats, Floats, Floats | None],
        intensity: NDArray,
        depth: NDArray | None,
        ids: NDArray | None,
    ) -> None:
        rotations, positions = self._checked(*placements[:2])
        gains = np.ones(len(rotations)) if placements[2] is None else placements[2]
        if gains.shape != rotations.shape[:1]:
            raise AcquisitionError(f"found gains {gains.shape}", f"one for each of {len(rotations)} instants")
        gains = np.ascontiguousarray(gains, dtype=np.float64)
        arrays = (rotations, positions, gains, intensity, depth, ids)
        load_library("acquisition").raycast_frames(
            ctypes.byref(self._scene),
            ctypes.byref(self._view),
            ctypes.byref(self._still),
            ctypes.c_int64(len(rotations)),
            *(ctypes.c_void_p(None if a is None else a.ctypes.data) for a in arrays),
        )
