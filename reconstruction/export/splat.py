"""`.splat`: 32 bytes a Gaussian without a header, the most important first, so that a viewer can show what has come.

Three float32 of position and three of linear scale, then bytes: grey thrice, opacity, and the quaternion (w, x, y, z)
as 128 + 128 q. Axes and grey are those of `ply`. Importance is opacity times volume.
Source: antimatter15/splat, `convert.py` (the format's reference).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquisition.durable import write_durably
from acquisition.progress import Progress
from reconstruction.export.scene import Choices, Scene, Splats, splats_at

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("colour", "u1", 4), ("quat_wxyz", "u1", 4)])


def write_splat(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """The Gaussians at one instant."""
    write_durably(path, splat_bytes(splats_at(scene, scene.instant_s(choices))))
    progress(1.0, path.name)
    return {}


def splat_bytes(splats: Splats) -> bytes:
    """The file's bytes."""
    importance = splats.opacities * splats.scales.astype(np.float64).prod(axis=1)
    splats = splats.select(np.argsort(-importance, kind="stable"))
    rows = np.zeros(len(splats), ROW)
    rows["means"], rows["scales"] = splats.means, splats.scales
    rows["colour"][:, :3] = _bytes(255 * splats.display())[:, None]
    rows["colour"][:, 3] = _bytes(255 * splats.opacities)
    rows["quat_wxyz"] = _bytes(128 + 128 * splats.quats_wxyz)
    return rows.tobytes()


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
