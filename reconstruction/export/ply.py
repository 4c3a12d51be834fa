"""`.ply` as 3D Gaussian splatting stores it: the master that other tools read. Binary, little-endian, float32.

Axes are the rig's, OpenCV's, as in 3DGS. `scale_*` are logs, `opacity` is a logit, `rot_*` is (w, x, y, z); `f_dc_*`
are coefficients of degree 0, so that a colour is 0.5 + 0.282 f_dc. Splat viewers blend what a screen shows, not light,
so the grey is intensity / white with gamma 2.2; where Gaussians overlap the picture then is darker than ours.
Source: Kerbl et al., "3D Gaussian splatting", SIGGRAPH 2023, and its reference code's `save_ply`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquisition.durable import write_durably
from acquisition.progress import Progress
from reconstruction.export.scene import SH_0, Choices, Scene, Splats, splats_at

NAMES = (
    *("x", "y", "z", "nx", "ny", "nz"),
    *("f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
MOST = 1 - 1e-6  # opacity whose logit is still finite


def write_ply_sequence(folder: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """NNNNNN.ply at even instants; the manifest has the seconds of each."""
    folder.mkdir()
    instants, frames = scene.instants_s(choices), []
    for i, instant_s in enumerate(instants):
        file = f"{i:06d}.ply"
        write_durably(folder / file, ply_bytes(splats_at(scene, instant_s)))
        frames.append({"file": file, "instant_s": instant_s})
        progress((i + 1) / len(instants), f"frame {i + 1} of {len(instants)}")
    return {"frames": frames}


def ply_bytes(splats: Splats) -> bytes:
    """The file's bytes, of Gaussians at one instant."""
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
