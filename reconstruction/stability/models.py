"""Makes a small cloud by every motion model, and compares its float32 with its float64."""

import math

import numpy as np
import torch
from torch import Tensor

from acquisition.native import code_path, code_paths
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.timesteps import TimestepMotion
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points, Seeds
from reconstruction.methods.catalogue import METHODS
from reconstruction.scene_model import TimeSpan
from reconstruction.stability.probe import Apart, slopes_of, worst

CLIP = TimeSpan(0.0, 0.02)
INSTANTS = 8
BESIDE = 6  # points of an instant, four of them on a body
POINTS = INSTANTS * BESIDE
TIMES_S = (np.arange(INSTANTS) + 0.5) / INSTANTS * CLIP.last_s


def model_names() -> tuple[str, ...]:
    """Return the names of the models whose Gaussians move."""
    return ("linear", "cubic", "bases", "4dgs", "4dgs-small", "stg", "d3dgs")


def cloud_of(name: str, scale: float = 1.0, count: int = POINTS) -> DynamicCloud:
    """Return a model's cloud of `count` points, up to POINTS, with lengths in `scale` m, after all of it has moved."""
    rng, times = np.random.default_rng(0), np.repeat(TIMES_S, BESIDE)[:count]
    places, light = scale * rng.normal(size=(count, 3)), rng.random(count).astype(np.float32)
    points = Points(places, light, np.full(count, 0.02 * scale), times)
    cloud = METHODS[name].start(Seeds(Points.none(), points, CLIP, INSTANTS, 0, (), lambda: _bodies(scale, count)))
    assert isinstance(cloud, DynamicCloud)
    generator = torch.Generator().manual_seed(1)
    for key, tensor in cloud.motion.tensors():
        if key in ("velocities", "accelerations", "jerks", "drifts"):
            tensor[:] = scale
        elif key == "turns":
            tensor[:] = 1
        elif key == "heads":  # the last layer of a field, which starts at zero
            tensor[:] = 0.1 * torch.randn(tensor.shape, generator=generator)
    for done in (0.5, 0.8, 1.0) if isinstance(cloud.motion, TimestepMotion) else ():
        cloud.advance(done)
        cloud.moving.means += 0.01 * scale
    return cloud


def _bodies(scale: float, count: int) -> Bodies:
    """Return a body that turns half a circle."""
    angles = np.linspace(0, math.pi, INSTANTS) / 2
    quats = np.stack([np.cos(angles), 0 * angles, 0 * angles, np.sin(angles)], axis=1)[None]
    centers = scale * np.stack([angles, 0 * angles, 0 * angles], axis=1)[None]
    owners = np.resize([0, 0, 0, 0, -1, -1], count)
    return Bodies(owners, quats, centers, TIMES_S, np.array([[0, INSTANTS - 1]]), np.full(count, ""))


def evaluated(cloud: DynamicCloud, instant_s: float) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Return the cloud at an instant, and the gradients of an uneven sum of it, in float64."""
    own = DynamicCloud.from_state(cloud.state())
    leaves = [t.requires_grad_() for name, t in own.tensors() if name in own.rates()]
    now = own.at(instant_s)
    generator = torch.Generator().manual_seed(2)
    total = sum((t.double() * torch.rand(t.shape, generator=generator)).sum() for t in now)
    assert isinstance(total, Tensor)
    total.backward()
    return tuple(t.detach().double() for t in now), slopes_of(leaves)


def against_float64(cloud: DynamicCloud, instants_s: tuple[float, ...]) -> Apart:
    """Return the worst errors of the cloud in float32, by every code path, against float64; infinite where unsound."""
    errors = []
    for instant_s in instants_s:
        values, slopes = evaluated(cloud.to(torch.float64), instant_s)
        for name in code_paths():
            with code_path(name):
                found, steep = evaluated(cloud, instant_s)
            errors.append(Apart.of(found, values, steep, slopes))
    return worst(errors)
