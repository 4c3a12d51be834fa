"""Renders a short image as the mean light of its planes, where movers get far in them.

A short image (`images.interpolated`) is the mean of several planes. A render of its middle instant learns that blur as
a texture; the mean of two renders, at the Gauss-Legendre instants, is blurred alike and the texture behind it sharp.
A long exposure, as an ordinary camera has, takes more of them.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from reconstruction.rendering.result import Rendering
from reconstruction.scene_model import SceneModel
from rigs.camera import Camera
from rigs.clock import RigClock

FROM = 0.5  # share of the training from which blur matters: before it, other errors are larger
FAR_PX = 0.8  # pixels that a fast mover gets far in an image before several instants are rendered
PX_A_NODE, MOST_NODES = 4.0, 8  # pixels of motion that an instant stands for, and most instants of an image
FASTEST = 0.9  # share of the moving Gaussians that are slower than a fast mover
LEAST_OPACITY = 0.1  # opacity of a Gaussian that counts
LOOKS = 16  # instants of the clip at which speeds are measured
MOST_POINTS = 500  # Gaussians whose speeds are measured at an instant


class Exposure:
    """Decides how many instants stand for an image of `planes` planes: one, until `look` finds that movers get far.

    `passed_px`: pixels that a fast mover gets far in an image, None before the look.
    """

    def __init__(self, planes: int, clock: RigClock):
        self.planes, self.clock = planes, clock
        self.passed_px: float | None = None

    @property
    def nodes(self) -> int:
        """The number of instants that are rendered for an image."""
        if self.passed_px is None or self.passed_px < FAR_PX:
            return 1
        return max(2, math.ceil(min(self.passed_px / PX_A_NODE, MOST_NODES)))

    def look(self, cloud: SceneModel, cameras: Sequence[Camera], done: float) -> None:
        """Measure once, as soon as `done` of the training reaches FROM."""
        if self.passed_px is None and done >= FROM:
            self.passed_px = passed_px(cloud, cameras, self.planes / self.clock.tick_rate_hz)


def mean_of(renders: Sequence[tuple[float, Rendering]]) -> Rendering:
    """Return the mean of renders at several instants, each with its weight; weights sum to 1."""
    if len(renders) == 1:
        return renders[0][1]
    means = {
        name: torch.stack([weight * getattr(rendered, name) for weight, rendered in renders]).sum(dim=0)
        for name in ("intensity", "depth", "alpha")
    }
    return renders[-1][1]._replace(median=None, **means)


def passed_px(cloud: SceneModel, cameras: Sequence[Camera], span_s: float) -> float:
    """Return how far a fast mover gets in `span_s` seconds in the pictures of `cameras`, px; 0 where nothing moves.

    Nine in ten of the moving points that are there and in the picture are slower. NaN and infinity do not count.
    """
    if not len(cloud.moving):
        return 0.0
    clip, found = cloud.clip, [np.zeros(1)]
    for middle_s in np.linspace(clip.first_s, clip.last_s, LOOKS + 2)[1:-1]:
        with torch.no_grad():
            (before, early), (after, late) = (cloud.movers(middle_s + s * span_s) for s in (-0.5, 0.5))
        there = np.flatnonzero((torch.minimum(early, late) > LEAST_OPACITY).cpu().numpy())
        there = there[:: max(1, -(-len(there) // MOST_POINTS))]
        points = [means.cpu().numpy()[there].astype(np.float64) for means in (before, after)]
        found += [_shifts_px(camera, *points) for camera in cameras]
    return float(np.quantile(np.concatenate(found), FASTEST))


def _shifts_px(camera: Camera, before: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return distances [k] px in the picture from `before` to `after` [n, 3] of points inside it at both ends."""
    (first, inside), (last, still_inside) = (camera.project(points) for points in (before, after))
    return np.linalg.norm((last - first)[inside & still_inside], axis=1)
