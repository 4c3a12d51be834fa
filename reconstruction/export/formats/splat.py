"""`.splat`: 32 bytes a Gaussian without a header, the most important first, so that a viewer can show the part it has.

Three float32 of position and three of linear scale, then bytes: three times the grey, the opacity, and the quaternion
(w, x, y, z) as 128 + 128 q. Axes and grey are those of `ply`. Importance is opacity times volume.
Source: antimatter15/splat, `convert.py` (the format's reference).
"""

import numpy as np

from reconstruction.export.splats import Splats, splat_format, to_bytes

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("colour", "u1", 4), ("quat_wxyz", "u1", 4)])


def splat_bytes(splats: Splats) -> bytes:
    """Return the bytes of a file of Gaussians at one instant."""
    importance = splats.opacities * splats.scales.astype(np.float64).prod(axis=1)
    splats = splats.select(np.argsort(-importance, kind="stable"))
    rows = np.zeros(len(splats), ROW)
    rows["means"], rows["scales"] = splats.means, splats.scales
    rows["colour"][:, :3] = to_bytes(255 * splats.display())[:, None]
    rows["colour"][:, 3] = to_bytes(255 * splats.opacities)
    rows["quat_wxyz"] = to_bytes(128 + 128 * splats.quats_wxyz)
    return rows.tobytes()


SPLAT = splat_format("splat", "the Gaussians at one instant in 32 bytes each", splat_bytes)
