"""A finished picture of a model: what `render`, the metrics and the report show."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from reconstruction.radiance_fields.field import RadianceField
from reconstruction.radiance_fields.march import STEP, march
from reconstruction.radiance_fields.model import Model
from reconstruction.rendering.pinhole import pinhole_of
from reconstruction.rendering.render import NEAR_M, render
from rigs.camera import Camera


@dataclass(frozen=True, eq=False)
class View:
    """Linear intensity [H, W] in spikes per tick and depth [H, W] in m along z.

    A reconstruction's depth is the median one, NaN where less than half the light is taken.
    """

    intensity: NDArray[np.float32]
    depth: NDArray[np.float32]


def look(model: Model, camera: Camera, instant_s: float) -> View:
    """What `camera` sees at `instant_s` on the rig clock."""
    with torch.no_grad():
        if isinstance(model, RadianceField):
            return _marched(model, camera, instant_s)
        rendering = render(model.at(instant_s), camera, median=True)
    assert rendering.median is not None
    return View(rendering.intensity[..., 0].numpy(), rendering.median.numpy())


def _marched(field: RadianceField, camera: Camera, instant_s: float) -> View:
    pinhole_of(camera, NEAR_M)  # refuses a lens that distorts
    rows, columns = np.indices((camera.height, camera.width)).reshape(2, -1)
    rays = field.frustum.rays(camera, columns, rows)
    seen = march(field.grids, rays.lines, torch.full((len(rays),), 0.5), STEP, field.at(instant_s))
    depth = field.frustum.depths(rays, seen.middle)
    return View(*(image.view(camera.height, camera.width).numpy() for image in (seen.light, depth)))
