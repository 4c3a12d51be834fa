"""Makes a small cloud by every motion model, and compares its float32 with its float64."""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import torch
from torch import Tensor

from acquisition.native import code_path, code_paths
from reconstruction.gaussians.canonical import CanonicalMotion
from reconstruction.gaussians.deformation import DeformationMotion
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points
from reconstruction.initialization.seeding import seed_cloud, seed_field, seed_rigid, seed_spacetime, seed_timesteps
from reconstruction.scene_model import TimeSpan
from reconstruction.stability.probe import Apart, slopes_of, worst

CLIP = TimeSpan(0.0, 0.02)
INSTANTS = 8
BESIDE = 6  # points of an instant, four of them on a body
POINTS = INSTANTS * BESIDE
TIMES_S = (np.arange(INSTANTS) + 0.5) / INSTANTS * CLIP.last_s


def models() -> Mapping[str, Callable[..., DynamicCloud]]:
    """Return by name the makers of a cloud of `count` moving points, up to POINTS, with lengths in `scale` m."""
    return {
        "linear": partial(_free, cubic=False),
        "cubic": partial(_free, cubic=True),
        "bases": _rigid,
        "4dgs": partial(_field, model=HexPlaneMotion),
        "dy-spikegs": partial(_field, model=DeformationMotion),
        "stg": _spacetime,
        "d3dgs": _timesteps,
    }


def model_names() -> tuple[str, ...]:
    """Return the names of `models`."""
    return tuple(models())


def _points(scale: float, count: int) -> Points:
    rng, times = np.random.default_rng(0), np.repeat(TIMES_S, BESIDE)[:count]
    places, light = scale * rng.normal(size=(count, 3)), rng.random(count).astype(np.float32)
    return Points(places, light, np.full(count, 0.02 * scale), times)


def _free(scale: float = 1.0, count: int = POINTS, *, cubic: bool) -> DynamicCloud:
    return _shaken(seed_cloud(Points.none(), _points(scale, count), CLIP, INSTANTS, cubic=cubic), scale)


def _rigid(scale: float = 1.0, count: int = POINTS) -> DynamicCloud:
    """Return a cloud whose body turns half a circle."""
    angles = np.linspace(0, math.pi, INSTANTS) / 2
    quats = np.stack([np.cos(angles), 0 * angles, 0 * angles, np.sin(angles)], axis=1)[None]
    centers = scale * np.stack([angles, 0 * angles, 0 * angles], axis=1)[None]
    owners = np.resize([0, 0, 0, 0, -1, -1], count)
    bodies = Bodies(owners, quats, centers, TIMES_S, np.array([[0, INSTANTS - 1]]), np.full(count, ""))
    return _shaken(seed_rigid(Points.none(), _points(scale, count), CLIP, INSTANTS, bodies), scale)


def _field(scale: float = 1.0, count: int = POINTS, *, model: type[CanonicalMotion]) -> DynamicCloud:
    """Return a field whose last layer, which starts at zero, deforms."""
    cloud = seed_field(Points.none(), _points(scale, count), CLIP, 0, model)
    generator = torch.Generator().manual_seed(1)
    for name, tensor in cloud.motion.tensors():
        if name in ("heads", "exit"):
            tensor[:] = 0.1 * torch.randn(tensor.shape, generator=generator)
    return cloud


def _spacetime(scale: float = 1.0, count: int = POINTS) -> DynamicCloud:
    cloud = _shaken(seed_spacetime(Points.none(), _points(scale, count), CLIP, INSTANTS), scale)
    for name, tensor in cloud.motion.tensors():
        if name == "turns":
            tensor[:] = 1
    return cloud


def _timesteps(scale: float = 1.0, count: int = POINTS) -> DynamicCloud:
    """Return a cloud as after a whole training that moved it a little."""
    cloud = seed_timesteps(Points.none(), _points(scale, count), CLIP)
    for done in (0.5, 0.8, 1.0):
        cloud.advance(done)
        cloud.moving.means += 0.01 * scale
    return cloud


def _shaken(cloud: DynamicCloud, scale: float) -> DynamicCloud:
    for name, tensor in cloud.motion.tensors():
        if name in ("velocities", "accelerations", "jerks"):
            tensor[:] = scale
    return cloud


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
