"""The error to expect of a rendering, pixel by pixel, from the evidence of the training views.

The expected square of render minus truth is a sum of terms, each of which can be told at any view and instant. Their
weights were fitted by `spike4dgs bench uncertainty`, on development scenes.
Letters: N Gaussians, V training views, K terms, H rows, W columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.rendering.bent import image_through
from reconstruction.rendering.render import render
from reconstruction.rendering.result import Instantaneous, Rendering
from reconstruction.uncertainty.evidence import Evidence, GaussianScene, SceneEvidence
from rigs.camera import Camera

# Each term's factor in the square of the error, both relative to white.
WEIGHTS = {
    "misfit": 0.53,  # misfit of the Gaussians
    "edges": 5.5,  # the same where the depth jumps: there little shifts show
    "holes": 0.001,  # what shows in holes, where light passes through everything
    "misfit outside": 42.0,  # misfit of the Gaussians, times their breadth and how far outside the viewer is
    "light outside": 0.00022,  # the square of the light, times how far outside the viewer is
    "holes outside": 0.49,  # what shows in holes, times the same
}
WIDEST_RAD = 1.0  # largest breadth of a Gaussian that counts
FARTHEST = 20.0  # bound of how far outside a viewer is; a Gaussian that no camera has seen is looked at from there
NARROWEST_RAD = 0.02  # least spread of the cameras' directions
JUMP = 0.02  # change of the depth from pixel to pixel, relative to it, that is an edge
TINY = 1e-12  # what keeps a quotient finite


@dataclass(frozen=True)
class Uncertainty:
    """Tells the expected error of a scene from its evidence."""

    scene: GaussianScene
    evidence: SceneEvidence

    def look(self, camera: Camera, instant_s: float) -> NDArray[np.float32]:
        """Return the root of the expected square error [H, W] in the picture of `camera`, in spikes per tick."""

        def expected(pinhole: Camera) -> NDArray[np.float32]:
            squares = torch.tensordot(torch.tensor(list(WEIGHTS.values())), self.terms(pinhole, instant_s), 1)
            return (self.evidence.white * squares.sqrt()).numpy()

        return image_through(camera, expected)

    @torch.no_grad()
    def terms(self, camera: Camera, instant_s: float) -> Tensor:
        """Return the terms [K, H, W], in the order of WEIGHTS, in the picture of a pinhole at an instant."""
        number = self.scene.number_at(instant_s) if isinstance(self.scene, SpannedScene) else 0
        part = self.scene.part(number) if isinstance(self.scene, SpannedScene) else self.scene
        now, known = part.at(instant_s), self.evidence.at(number)
        away = torch.tensor(camera.center, dtype=torch.float32) - now.means
        breadth = (now.log_scales.exp().amax(dim=1) / away.norm(dim=1).clamp_min(TINY)).clamp(max=WIDEST_RAD)
        own_light, outside = now.intensities[:, 0] / self.evidence.white, self._outside(now, away, known)
        channels = torch.stack([known.misfit, own_light, outside, known.misfit * breadth * outside], dim=1)
        seen = render(now._replace(intensities=channels), camera, dilation_px2=part.dilation_px2)
        misfit, light, out, misfit_out = seen.intensity.clamp_min(0).unbind(-1)
        holes = (1 - seen.alpha).clamp(0, 1) * self.evidence.void
        return torch.stack([misfit, _edges(seen) * misfit, holes, misfit_out, light.square() * out, holes * out])

    def _outside(self, now: Instantaneous, away: Tensor, known: Evidence) -> Tensor:
        """Return how far outside its cameras each Gaussian [N] is looked at by a viewer who is `away` [N, 3] m.

        It is the leverage of the viewer's direction among those of the cameras that saw the Gaussian: how much less
        certain a plane through their samples is there than in their middle. It is bounded by FARTHEST.
        Source: Hoaglin & Welsch, "The hat matrix in regression and ANOVA", The American Statistician 1978.
        """
        seen = known.seen[..., None].float()
        ways = torch.nn.functional.normalize(self.evidence.centres - now.means[:, None], dim=2)
        middle = (seen * ways).sum(dim=1) / seen.sum(dim=1).clamp_min(1)
        apart = seen * (ways - middle[:, None])
        spread = apart.transpose(1, 2) @ apart + NARROWEST_RAD**2 * torch.eye(3)
        off = torch.nn.functional.normalize(away, dim=1) - middle
        leverage = quadratic_inverse(spread, off).clamp_min(0)
        bounded = leverage / (1 + leverage / FARTHEST)
        return torch.where(known.seen.any(dim=1), bounded, torch.full_like(bounded, FARTHEST))


def quadratic_inverse(matrices: Tensor, vectors: Tensor) -> Tensor:
    """Return v^T A^-1 v [N] of symmetric A [N, 3, 3] and v [N, 3].

    It is done by adjugates: solvers of many small systems take a hundred times as long.
    """
    a, b, c = matrices.unbind(dim=1)
    adjugate = torch.stack([torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], dim=1)
    determinant = (a * adjugate[:, 0]).sum(dim=1)
    return ((adjugate @ vectors[..., None])[..., 0] * vectors).sum(dim=1) / determinant


def _edges(seen: Rendering) -> Tensor:
    """Return 1 where the depth jumps, else 0, [H, W]."""
    depth = torch.nn.functional.pad((seen.depth / seen.alpha.clamp_min(1e-3))[None], (1, 1, 1, 1), "replicate")[0]
    down, right = depth[2:, 1:-1] - depth[:-2, 1:-1], depth[1:-1, 2:] - depth[1:-1, :-2]
    return (torch.hypot(down, right) / 2 > JUMP * depth[1:-1, 1:-1].clamp_min(TINY)).float()
