"""`.ply` as 3D Gaussian splatting stores it: the master that other tools read. Binary, little-endian, float32.

Axes are the rig's, OpenCV's, as in 3DGS. `scale_*` are logs, `opacity` is a logit, `rot_*` is (w, x, y, z); `f_dc_*`
are coefficients of degree 0, so that a colour is 0.5 + 0.282 f_dc. Splat viewers blend display greys, not light, so the
grey is intensity / white with gamma 2.2; where Gaussians overlap, the picture is darker than ours.
Source: Kerbl et al., "3D Gaussian splatting", SIGGRAPH 2023, and its reference code's `save_ply`.
"""

import numpy as np

from reconstruction.export.splats import SH_0, Splats, splat_format

NAMES = (
    *("x", "y", "z", "nx", "ny", "nz"),
    *("f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
MOST = 1 - 1e-6  # largest opacity whose logit is still finite


def ply_bytes(splats: Splats) -> bytes:
    """Return the bytes of a file of Gaussians at one instant."""
    rows = np.zeros((len(splats), len(NAMES)), "<f4")
    opacities = np.clip(splats.opacities.astype(np.float64), 1 - MOST, MOST)
    rows[:, :3] = splats.means
    rows[:, 6:9] = ((splats.display() - 0.5) / SH_0)[:, None]
    rows[:, 9] = np.log(opacities / (1 - opacities))
    rows[:, 10:13] = np.log(splats.scales)
    rows[:, 13:] = splats.quats_wxyz
    properties = "".join(f"property float {name}\n" for name in NAMES)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(splats)}\n{properties}end_header\n"
    return header.encode() + rows.tobytes()


PLY = splat_format(
    "ply", "the Gaussians at one instant as 3DGS stores them: OpenCV axes, log scales, logits", ply_bytes
)
