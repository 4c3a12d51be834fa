"""Still Gaussians beside Gaussians that move, by one of the models that `MODELS` lists.

Letters: N still, M moving. Time is in clips: 0 at the clip's start, 1 at its end.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion, SmallHexPlaneMotion
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spacetime import SpacetimeMotion
from reconstruction.gaussians.timesteps import TimestepMotion
from reconstruction.rendering.bent import seen_through
from reconstruction.rendering.render import render
from reconstruction.rendering.result import GUARDS, Instantaneous
from reconstruction.scene_model import Rate, TimeSpan, View, gain_at
from rigs.camera import Camera

MODELS: dict[str, type[MotionModel]] = {
    m.kind: m
    for m in (PolynomialMotion, RigidMotion, HexPlaneMotion, SmallHexPlaneMotion, SpacetimeMotion, TimestepMotion)
}
UNSAID_PX2 = 0.3  # dilation of a stored scene that names none, as those of earlier revisions


@dataclass
class DynamicCloud:
    """N still Gaussians and M moving ones with their motion; see `scene_model.SceneModel`.

    `dilation_px2`: what renders add to the covariance of a splat, px^2; the same in training and afterwards.
    """

    still: GaussianCloud
    moving: GaussianCloud
    motion: MotionModel
    clip: TimeSpan
    light: Tensor = field(default_factory=lambda: torch.ones(1))
    dilation_px2: float = GUARDS.dilation_px2
    unit: ClassVar[str] = "Gaussians"

    def __len__(self) -> int:
        return len(self.still) + len(self.moving)

    @property
    def networks(self) -> bool:
        """Tell whether networks or grids move the Gaussians."""
        return self.motion.networks

    @property
    def given(self) -> int:
        """The number of leading Gaussians of `at` that nothing is learnt of."""
        return 0

    def at(self, instant_s: float) -> Instantaneous:
        """Return all Gaussians at one instant of the rig clock; differentiable in every stored tensor."""
        still, moving, u = self.still, self.moving, self.clip.fraction(instant_s)
        now = Instantaneous(
            still.means, still.quats_wxyz, still.log_scales, still.opacity_logits.sigmoid(), still.intensities
        )
        if len(moving):
            pairs = zip(now, self.motion.at(moving, u), strict=True)
            now = Instantaneous(*(torch.cat(pair) for pair in pairs))
        return now if len(self.light) == 1 else now._replace(intensities=now.intensities * gain_at(self.light, u))

    @property
    def changes(self) -> bool:
        """Tell whether the cloud differs between instants."""
        return len(self.moving) > 0 or len(self.light) > 1

    def look(self, camera: Camera, instant_s: float) -> View:
        """Return what `camera` sees at `instant_s` on the rig clock, through its lens."""
        return seen_through(camera, lambda pinhole: self._looked(pinhole, instant_s))

    def _looked(self, camera: Camera, instant_s: float) -> View:
        with torch.no_grad():
            rendering = render(self.at(instant_s), camera, dilation_px2=self.dilation_px2, median=True)
        assert rendering.median is not None
        return View(rendering.intensity[..., 0].numpy(), rendering.median.numpy())

    def positions(self, instant_s: float) -> Tensor:
        """Return the positions [N + M, 3] in m of all Gaussians at an instant of the rig clock."""
        return self.at(instant_s).means

    def movers(self, instant_s: float) -> tuple[Tensor, Tensor]:
        """Return positions [M, 3] in m and opacities [M] of the moving Gaussians at an instant of the rig clock."""
        now = self.motion.at(self.moving, self.clip.fraction(instant_s))
        return now.means, now.opacities

    def rates(self) -> Mapping[str, Rate]:
        """Return the learning rate of every tensor that is learnt, by name."""
        own = {f"{part}.{kind}": rate for part in ("still", "moving") for kind, rate in GaussianCloud.rates.items()}
        return own | {f"motion.{kind}": rate for kind, rate in self.motion.rates.items()}

    def advance(self, done: float) -> float:
        """Tell the motion that `done` (0 to 1) of the training is over; return how much of its own stage is."""
        return self.motion.advance(self.moving, done)

    def penalty(self) -> Tensor | None:
        """Return the scalar that the motion's own regulariser adds to the loss, or None where it has none."""
        return self.motion.penalty(self.moving)

    def opacity(self) -> Tensor:
        """Return the largest share of the light that each Gaussian takes, [N + M] in 0 to 1, without gradients."""
        return torch.cat([part.opacity_logits.detach() for part in (self.still, self.moving)]).sigmoid()

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Yield every stored tensor with its name, `still.means` to `motion.log_durations`."""
        for name in ("still", "moving"):
            for key, tensor in vars(getattr(self, name)).items():
                yield f"{name}.{key}", tensor
        for key, tensor in self.motion.tensors():
            yield f"motion.{key}", tensor

    def to(self, kind: torch.dtype | torch.device) -> DynamicCloud:
        """Return the same cloud in another float type, or on another device; its light stays on the processor."""
        floats = isinstance(kind, torch.dtype)
        stored = self.state()["tensors"].items()
        tensors = {k: t if floats and not t.is_floating_point() else t.to(kind) for k, t in stored}
        return DynamicCloud.from_state({**self.state(), "tensors": tensors})

    def state(self) -> dict[str, Any]:
        """Return tensors, numbers and names, for a checkpoint."""
        return {
            "clip": [self.clip.first_s, self.clip.last_s],
            "light": self.light.clone(),
            "dilation_px2": self.dilation_px2,
            "model": self.motion.kind,
            "tensors": {k: v.detach().clone() for k, v in self.tensors()},
        }

    @classmethod
    def from_state(cls, state: dict) -> DynamicCloud:
        """Return the cloud whose `state` this is; raises ReconstructionError for an unknown model or tensors."""
        parts: dict[str, dict[str, Tensor]] = {"still": {}, "moving": {}, "motion": {}}
        kind = state.get("model", PolynomialMotion.kind)
        try:
            for name, tensor in state["tensors"].items():
                part, key = name.split(".")
                parts[part][key] = tensor
            motion = MODELS[kind](**parts["motion"])
            first_s, last_s = state["clip"]
            still, moving = (GaussianCloud(**parts[name]) for name in ("still", "moving"))
            light, dilation_px2 = state.get("light", torch.ones(1)), state.get("dilation_px2", UNSAID_PX2)
            return cls(still, moving, motion, TimeSpan(first_s, last_s), light, dilation_px2)
        except (KeyError, TypeError, ValueError) as error:
            found = f"the model {kind!r} with {', '.join(parts['motion']) or 'no tensors'}"
            raise ReconstructionError(
                f"found {found}", f"one of {', '.join(MODELS)} as this version stores it", "train again"
            ) from error
