"""A finished picture of a dynamic cloud: what `render`, the metrics and the report show."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.rendering.render import render
from rigs.camera import Camera


@dataclass(frozen=True, eq=False)
class View:
    """Linear intensity [H, W] in spikes per tick and depth [H, W] in m along z.

    A reconstruction's depth is the median one, NaN where less than half the light is taken.
    """

    intensity: NDArray[np.float32]
    depth: NDArray[np.float32]


def look(cloud: DynamicCloud, camera: Camera, instant_s: float) -> View:
    """What `camera` sees at `instant_s` on the rig clock."""
    with torch.no_grad():
        rendering = render(cloud.at(instant_s), camera, median=True)
    assert rendering.median is not None
    return View(rendering.intensity[..., 0].numpy(), rendering.median.numpy())
