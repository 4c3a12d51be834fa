"""Reads photographs that come with the packages as linear light, each scaled to 0..1."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.realistic.library import folder_of, mitsuba

_FOLDERS = {"skimage": "data", "pybullet_data": ""}


@functools.lru_cache(maxsize=32)
def picture(name: str, shrink: int = 1) -> NDArray[np.float32]:
    """Return the light [H, W, 1] of the file `PACKAGE/FILE`, its darkest 1% at 0 and its lightest 1% at 1.

    `shrink` x `shrink` texels become their mean.
    """
    mi = mitsuba()
    package, file = name.split("/", 1)
    bitmap = mi.Bitmap(str(folder_of(package) / _FOLDERS[package] / file))
    grey = bitmap.convert(mi.Bitmap.PixelFormat.Y, mi.Struct.Type.Float32, srgb_gamma=False)
    light = np.array(grey, dtype=np.float64).reshape(bitmap.height(), bitmap.width())
    rows, columns = (size // shrink for size in light.shape)
    light = light[: rows * shrink, : columns * shrink].reshape(rows, shrink, columns, shrink).mean(axis=(1, 3))
    low, high = np.quantile(light, (0.01, 0.99))
    return np.clip((light - low) / (high - low), 0, 1).astype(np.float32)[..., None]
