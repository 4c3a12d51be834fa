"""`.splat`: 32 bytes a Gaussian without a header, the most important first, so that a viewer can show what has come.

Three float32 of position and three of linear scale, then bytes: grey thrice, opacity, and the quaternion (w, x, y, z)
as 128 + 128 q. Axes and grey are those of `ply`. Importance is opacity times volume.
Source: antimatter15/splat, `convert.py` (the format's reference).
"""

from __future__ import annotations

import numpy as np

from reconstruction.export.scene import Splats

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("colour", "u1", 4), ("quat_wxyz", "u1", 4)])


def splat_bytes(splats: Splats) -> bytes:
    """The file's bytes, of Gaussians at one instant."""
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
