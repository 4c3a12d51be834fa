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
    "misfit": 1200.0,  # misfit of the Gaussians, times their breadth and the angle to the nearest who saw them
    "edges": 0.14,  # the root of their misfit where the depth jumps: there little shifts show
    "aside": 0.033,  # the square of the light, times the square of the angle to the nearest camera that saw it
    "holes": 0.13,  # what shows in holes, where light passes through everything
    "holes aside": 0.2,  # holes, times that angle: what is behind them nobody may have seen
}
WIDEST_RAD = 1.0  # largest angle that counts, and that to a camera where none has seen a Gaussian
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
        own_light = now.intensities[:, 0] / self.evidence.white
        channels = torch.stack([known.misfit, self._aside(now, away, known), breadth, own_light], dim=1)
        seen = render(now._replace(intensities=channels), camera, dilation_px2=part.dilation_px2)
        misfit, aside, broad, light = seen.intensity.clamp_min(0).unbind(-1)
        hole, edges = (1 - seen.alpha).clamp(0, 1), _edges(seen) * misfit.sqrt()
        holes = hole * self.evidence.void
        return torch.stack([misfit * broad * aside, edges, (aside * light).square(), holes, hole * aside])

    def _aside(self, now: Instantaneous, away: Tensor, known: Evidence) -> Tensor:
        """Return the angle [N] at each Gaussian from the viewer, who is `away` [N, 3] m, to the nearest that saw it."""
        nearest = torch.full((len(away),), -1.0)
        sight = torch.nn.functional.normalize(away, dim=1)
        for centre, saw in zip(self.evidence.centres, known.seen.T, strict=True):
            cosine = (torch.nn.functional.normalize(centre - now.means, dim=1) * sight).sum(dim=1)
            nearest = torch.where(saw, torch.maximum(nearest, cosine), nearest)
        return nearest.clamp(-1, 1).arccos().clamp(max=WIDEST_RAD)


def _edges(seen: Rendering) -> Tensor:
    """Return 1 where the depth jumps, else 0, [H, W]."""
    depth = torch.nn.functional.pad((seen.depth / seen.alpha.clamp_min(1e-3))[None], (1, 1, 1, 1), "replicate")[0]
    down, right = depth[2:, 1:-1] - depth[:-2, 1:-1], depth[1:-1, 2:] - depth[1:-1, :-2]
    return (torch.hypot(down, right) / 2 > JUMP * depth[1:-1, 1:-1].clamp_min(TINY)).float()
