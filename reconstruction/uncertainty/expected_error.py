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
    "misfit": 0.07,  # what the Gaussians did not fit in the training views
    "aside": 17.0,  # the same, times the angle to the nearest camera that saw them, rad
    "edges": 0.055,  # its root, where the depth jumps: there what is a little off shows
    "breadth": 0.03,  # the square of the angle that the Gaussians fill, rad: wide ones stand for what nobody saw
    "holes": 0.11,  # the square of the light that passes through everything
    "holes aside": 0.27,  # the same light, times that angle
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
        breadth = now.log_scales.exp().amax(dim=1) / away.norm(dim=1).clamp_min(TINY)
        channels = torch.stack([known.misfit, self._aside(now, away, known), breadth.clamp(max=WIDEST_RAD)], dim=1)
        seen = render(now._replace(intensities=channels), camera)
        misfit, aside, broad = seen.intensity.clamp_min(0).unbind(-1)
        hole = (1 - seen.alpha).clamp(0, 1)
        edges = _edges(seen) * misfit.sqrt()
        return torch.stack([misfit, misfit * aside, edges, broad.square(), hole.square(), hole * aside])

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
