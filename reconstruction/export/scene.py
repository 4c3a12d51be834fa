"""What every format is written from: a trained cloud, the cameras that saw it, and what counts as white."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from reconstruction.errors import BadRunError
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.images.composite import CompositeSource
from reconstruction.rendering.reference import ALPHA_MIN, LOG_SCALE_MAX, LOG_SCALE_MIN, unit_quats
from reconstruction.report.pictures import GAMMA
from reconstruction.scene_model import SceneModel
from rigs.camera import Camera
from rigs.rig import Rig

Floats = NDArray[np.float32]
FRAMES = 30
SH_0 = 0.28209479177387814  # the spherical harmonic of degree 0, 1 / (2 sqrt(pi))


@dataclass(frozen=True)
class Choices:
    """What an operator chose: seconds on the rig clock, the number of frames, a camera's id; None is the default."""

    at_s: float | None = None
    frames: int | None = None
    camera: str | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A trained run; `targets` reads the training views' target images, by camera, when it is called."""

    cloud: SceneModel
    rig: Rig
    white: float  # spikes per tick
    model: str  # as `--model` names it
    holdout: str | None
    targets: Callable[[], Mapping[str, CompositeSource]]

    @property
    def gaussians(self) -> DynamicCloud:
        """The cloud of a model made of Gaussians; raises BadRunError for one that is not."""
        if not isinstance(self.cloud, DynamicCloud):
            raise BadRunError(f"found the model {self.model}, a radiance field", "Gaussians", "export video or depth")
        return self.cloud

    @property
    def middle_s(self) -> float:
        """The middle of the clip on the rig clock."""
        return (self.cloud.clip.first_s + self.cloud.clip.last_s) / 2

    def instant_s(self, choices: Choices) -> float:
        """The instant chosen, by default the clip's middle; raises BadRunError for one outside the clip."""
        clip = self.cloud.clip
        if choices.at_s is None:
            return self.middle_s
        if not clip.first_s <= choices.at_s <= clip.last_s:
            raise BadRunError(
                f"found the instant {choices.at_s:g} s",
                f"one within the clip, {clip.first_s:g} to {clip.last_s:g} s",
                "change --at",
            )
        return choices.at_s

    def instants_s(self, choices: Choices) -> list[float]:
        """The middles of as many equal parts of the clip as frames are chosen."""
        clip, count = self.cloud.clip, choices.frames or FRAMES
        return [clip.first_s + (i + 0.5) / count * (clip.last_s - clip.first_s) for i in range(count)]

    def camera(self, choices: Choices) -> Camera:
        """The camera chosen, by default the held-out one, else the rig's middle one; raises RigError for another."""
        wanted = choices.camera or self.holdout or self.rig.ids[len(self.rig.ids) // 2]
        return self.rig.camera(wanted)


@dataclass(frozen=True, eq=False)
class Splats:
    """N Gaussians at one instant: rig frame, OpenCV axes, nothing encoded; all that any format needs."""

    means: Floats  # [N, 3] m
    quats_wxyz: Floats  # [N, 4] unit
    scales: Floats  # [N, 3] m, standard deviations
    opacities: Floats  # [N], 0 to 1, after the motion's gate
    intensities: Floats  # [N] linear, 1 is white

    def __len__(self) -> int:
        return len(self.means)

    def display(self) -> Floats:
        """Grey [N] as a screen wants it: gamma 2.2 as `report.pictures.grey`; what outshines white stays above 1."""
        return np.maximum(self.intensities, 0) ** np.float32(GAMMA)

    def select(self, which: NDArray) -> Splats:
        """Those at indices, in that order, or where a mask [N] is true."""
        return Splats(*(array[which] for array in vars(self).values()))


@torch.no_grad()
def splats_at(scene: Scene, instant_s: float) -> Splats:
    """The scene's Gaussians at `instant_s` on the rig clock, without those too faint to be drawn (under 1/255)."""
    now = scene.gaussians.at(instant_s)
    splats = Splats(
        now.means.numpy().astype(np.float32),
        unit_quats(now.quats_wxyz).numpy().astype(np.float32),
        linear_scales(now.log_scales),
        now.opacities.numpy().astype(np.float32),
        (now.intensities[:, 0] / scene.white).numpy().astype(np.float32),
    )
    return splats.select(splats.opacities >= ALPHA_MIN)


def linear_scales(log_scales: torch.Tensor) -> Floats:
    """Standard deviations in m, held within what the renderer draws."""
    return log_scales.clamp(LOG_SCALE_MIN, LOG_SCALE_MAX).exp().numpy().astype(np.float32)


def up_and_back(splats: Splats) -> Splats:
    """The same Gaussians in axes x right, y up, z backward (OpenGL, glTF): half a turn about x.

    The axes of a Gaussian are turned by R' = D R D with D = diag(1, -1, -1), which leaves its covariance D C D.
    """
    flip = np.array([1, -1, -1], np.float32)
    quats = splats.quats_wxyz * np.array([1, 1, -1, -1], np.float32)
    return Splats(splats.means * flip, quats, splats.scales, splats.opacities, splats.intensities)
