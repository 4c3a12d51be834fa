"""The Gaussians of a scene at one instant, with nothing encoded, and the formats that are one file of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress
from reconstruction.export.scene import Choices, Format, Scene
from reconstruction.report.display import GAMMA

if TYPE_CHECKING:
    from torch import Tensor

Floats = NDArray[np.float32]
SH_0 = 0.28209479177387814  # spherical harmonic of degree 0, 1 / (2 sqrt(pi))


@dataclass(frozen=True, eq=False)
class Splats:
    """N Gaussians at one instant, in the rig frame with OpenCV's axes."""

    means: Floats  # [N, 3] m
    quats_wxyz: Floats  # [N, 4] unit
    scales: Floats  # [N, 3] standard deviations in m
    opacities: Floats  # [N] 0 to 1, after the motion's gate
    intensities: Floats  # [N] linear, 1 is white

    def __len__(self) -> int:
        return len(self.means)

    def display(self) -> Floats:
        """Return the grey [N] that a screen wants, as `report.display.grey` does; beyond white it stays above 1."""
        return np.maximum(self.intensities, 0) ** np.float32(GAMMA)

    def select(self, which: NDArray) -> Splats:
        """Return the Gaussians at indices, in that order, or where a mask [N] is true."""
        return Splats(*(array[which] for array in vars(self).values()))

    def up_and_back(self) -> Splats:
        """Return the same Gaussians in axes x right, y up, z backward (OpenGL, glTF): half a turn about x.

        The axes of a Gaussian become R' = D R D with D = diag(1, -1, -1), so its covariance becomes D C D.
        """
        quats = self.quats_wxyz * np.array([1, 1, -1, -1], np.float32)
        return Splats(self.means * np.array([1, -1, -1], np.float32), quats, *list(vars(self).values())[2:])


def splats_at(scene: Scene, instant_s: float) -> Splats:
    """Return the scene's Gaussians at `instant_s` on the rig clock, without those under 1/255, which nobody draws.

    Raises BadRunError for a radiance field.
    """
    import torch

    from reconstruction.quaternions import unit
    from reconstruction.rendering.reference import ALPHA_MIN

    with torch.no_grad():
        now = scene.gaussians_at(instant_s).at(instant_s)
        shapes = floats(now.means), floats(unit(now.quats_wxyz)), linear_scales(now.log_scales)
        splats = Splats(*shapes, floats(now.opacities), floats(now.intensities[:, 0] / scene.white))
    return splats.select(splats.opacities >= ALPHA_MIN)


def splat_format(name: str, about: str, encode: Callable[[Splats], bytes]) -> Format:
    """Return the format of a single file: the bytes that `encode` makes of the Gaussians at the instant chosen."""

    def write(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
        splats = splats_at(scene, scene.instant_s(choices))
        path.write_bytes(encode(splats))
        progress(1.0, f"{len(splats)} Gaussians")
        return {}

    return Format(name, about, f"scene.{name}", write, ("at_s",))


def floats(tensor: Tensor) -> Floats:
    """Return a tensor as a float32 array of the same shape."""
    return tensor.detach().numpy().astype(np.float32)


def linear_scales(log_scales: Tensor) -> Floats:
    """Return the standard deviations in m of `log_scales` (log m), held within what the renderer draws."""
    from reconstruction.rendering.reference import LOG_SCALE_MAX, LOG_SCALE_MIN

    return floats(log_scales.clamp(LOG_SCALE_MIN, LOG_SCALE_MAX).exp())


def to_bytes(values: NDArray) -> NDArray[np.uint8]:
    """Return `values` rounded to whole numbers and held within 0 to 255."""
    return np.clip(np.round(values), 0, 255).astype(np.uint8)
