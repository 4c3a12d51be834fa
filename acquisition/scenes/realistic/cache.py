"""Keeps drawn light on disk, so that a scene is drawn once for each camera."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import map_array, write_array
from rigs.camera import Camera

FOLDER = "SPIKE4DGS_CACHE"  # names the folder; without it, that of the XDG base directories


def cache_folder() -> Path:
    """Return the folder of everything that can be made again."""
    named = os.environ.get(FOLDER)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(named) if named else Path(base) / "spike4dgs"


def camera_digest(camera: Camera) -> str:
    """Return what tells apart cameras that see different pictures, whatever their names."""
    pose = np.round(camera.cam_from_rig.matrix * 1e9).astype(np.int64).tolist()
    lens = [camera.width, camera.height, *(round(v * 1e6) for v in (camera.fx, camera.fy, camera.cx, camera.cy))]
    if camera.bends:
        lens += [camera.lens.model, *(round(k * 1e9) for k in camera.lens.coefficients)]
    return hashlib.sha256(json.dumps([lens, pose]).encode()).hexdigest()[:16]


class LightCache:
    """The drawn arrays of one scene and camera, by name; a file is whole or absent."""

    def __init__(self, scene_digest: str, camera: Camera):
        self._folder = cache_folder() / "light" / scene_digest[:24] / camera_digest(camera)

    def has(self, name: str) -> bool:
        """Return whether the array is there."""
        return self._path(name).exists()

    def read(self, name: str) -> NDArray:
        """Return the array, mapped into memory."""
        return map_array(self._path(name))

    def write(self, name: str, array: NDArray) -> None:
        """Store the array."""
        self._folder.mkdir(parents=True, exist_ok=True)
        write_array(self._path(name), array)

    def _path(self, name: str) -> Path:
        return self._folder / f"{name}.npy"
