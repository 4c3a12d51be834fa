"""Scenes to export: a small cloud with every motion model before a converging row of cameras."""

import math

import numpy as np
import pytest
import torch

from reconstruction.export.scene import Scene
from reconstruction.gaussians import hexplane
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.hexplane import FieldShape, HexPlaneMotion, SmallHexPlaneMotion, box_around
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spacetime import SpacetimeMotion
from reconstruction.gaussians.timesteps import TIMESTEPS, TimestepMotion
from reconstruction.scene_model import TimeSpan
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

WHITE = 0.4  # spikes per tick
CLIP = TimeSpan(0.002, 0.012)


def needles(count: int, seed: int) -> GaussianCloud:
    """Long, thin Gaussians in every direction, 1.6 to 2.4 m before the rig: a wrong quaternion shows."""
    generator = torch.Generator().manual_seed(seed)
    draw = lambda *shape: torch.rand(*shape, generator=generator)  # noqa: E731
    means = (draw(count, 3) - 0.5) * torch.tensor([1.2, 0.8, 0.8]) + torch.tensor([0.0, 0.0, 2.0])
    log_scales = torch.log(torch.tensor([0.12, 0.03, 0.01])).repeat(count, 1) + 0.2 * draw(count, 3)
    quats = 3 * torch.randn(count, 4, generator=generator)
    return GaussianCloud(means, quats, log_scales, 3 * draw(count) - 1, WHITE * draw(count, 1))


def motion_of(kind: str, moving: GaussianCloud):
    """A motion of M Gaussians that changes all that its model can change."""
    count, generator = len(moving), torch.Generator().manual_seed(5)
    draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
    instants, logs = torch.linspace(-0.2, 1.2, count), torch.full((count,), math.log(0.4))
    if kind == "cubic":
        return PolynomialMotion(0.3 * draw(count, 3), 0.4 * draw(count, 3), 0.5 * draw(count, 3), instants, logs)
    if kind == "stg":
        turns = draw(count, 4)
        return SpacetimeMotion(0.3 * turns[:, :3], 0.4 * draw(count, 3), 0.5 * draw(count, 3), instants, logs, turns)
    if kind == "d3dgs":
        motion = TimestepMotion.started(moving.means)
        for done in torch.linspace(0, 1, 2 * TIMESTEPS):
            motion.advance(moving, float(done))
            moving.means += 0.001 * draw(count, 3)
            moving.quats_wxyz += 0.02 * draw(count, 4)
        return motion
    if kind == "bases":
        riders, angles = count // 2, torch.linspace(0, 3, 5)
        zero = torch.zeros(5)
        quats = torch.stack([(angles / 2).cos(), zero, zero, (angles / 2).sin()], -1)[None]
        moving.means[:riders] -= torch.tensor([0.0, 0.0, 2.0])
        centers = torch.stack([0.1 * angles, zero, zero + 2], -1)[None]
        bodies = torch.zeros(riders, dtype=torch.int64)
        velocities, drifts = 0.3 * draw(count - riders, 3), 0.1 * draw(riders, 3)
        return RigidMotion(bodies, quats, centers, velocities, instants, logs, drifts)
    if kind in ("4dgs", "4dgs-small"):
        model = HexPlaneMotion if kind == "4dgs" else SmallHexPlaneMotion
        field = model.over(box_around(moving.means, 0.1), generator, 0.1)
        for name, tensor in field.tensors():
            if name in model.rates:
                tensor += 0.1 * draw(*tensor.shape)
        return field
    return PolynomialMotion(0.3 * draw(count, 3), torch.zeros(0, 3), torch.zeros(0, 3), instants, logs)


@pytest.fixture
def small_fields(monkeypatch):
    """Fields of a few cells."""
    monkeypatch.setattr(hexplane, "FEATURES", 2)
    for model, heads in ((HexPlaneMotion, 5), (SmallHexPlaneMotion, 3)):
        monkeypatch.setattr(model, "shape", FieldShape((4, 6), 5, 6, heads))


@pytest.fixture
def scene_with(small_fields):
    """A scene of some still Gaussians and some that move, by the model named."""

    def make(kind: str = "linear", still: int = 40, moving: int = 20) -> Scene:
        movers = needles(moving, 2)
        cloud = DynamicCloud(needles(still, 1), movers, motion_of(kind, movers), CLIP)
        return Scene(cloud, row_of_cameras(), WHITE, kind, "cam01", dict)

    return make


def row_of_cameras() -> Rig:
    """Three cameras that look at (0, 0, 2), turned and shifted against the rig's frame."""
    spots = ((-0.3, 0.1, 0.0), (0.05, -0.02, 0.1), (0.3, 0.05, -0.1))
    poses = [Transform.looking_at(spot, (0, 0, 2.0), (0.2, 1.0, 0)) for spot in spots]
    cameras = (Camera(f"cam0{i}", 64, 41, 55.0, 54.0, 33.0, 20.0, pose) for i, pose in enumerate(poses))
    return Rig("row", 20000.0, tuple(cameras))


@pytest.fixture
def empty_scene():
    """No Gaussians at all."""
    none = needles(0, 0)
    still = DynamicCloud(none, needles(0, 0), motion_of("linear", none), CLIP)
    return Scene(still, row_of_cameras(), WHITE, "static", None, dict)


@pytest.fixture
def one_scene():
    """One bright, round Gaussian off every axis."""
    log_scale = float(np.log(0.06))
    one = GaussianCloud(
        torch.tensor([[0.2, -0.1, 2.2]]),
        torch.tensor([[1.0, 0, 0, 0]]),
        torch.full((1, 3), log_scale),
        torch.tensor([4.0]),
        torch.tensor([[WHITE]]),
    )
    none = needles(0, 0)
    return Scene(
        DynamicCloud(one, none, motion_of("linear", none), CLIP), row_of_cameras(), WHITE, "static", None, dict
    )


@pytest.fixture
def cloud_of():
    """N Gaussians with numbers everywhere."""

    def make(n: int) -> GaussianCloud:
        generator = torch.Generator().manual_seed(n)
        draw = lambda *shape: torch.randn(*shape, generator=generator)  # noqa: E731
        return GaussianCloud(draw(n, 3), draw(n, 4), draw(n, 3), draw(n), draw(n, 1))

    return make


@pytest.fixture
def field_of():
    """A field over a cloud that deforms nothing yet, or, `trained`, one with numbers everywhere."""

    def make(model: type[HexPlaneMotion], cloud: GaussianCloud, *, trained: bool = True) -> HexPlaneMotion:
        generator = torch.Generator().manual_seed(7)
        motion = model.over(box_around(cloud.means, 0.1), generator, 0.3)
        for name, tensor in motion.tensors():
            if trained and name in model.rates:
                tensor.copy_(tensor + 0.3 * torch.randn(tensor.shape, generator=generator))
        return motion

    return make


class ToldLaboratory:
    """A laboratory that knows the result of every cell that `scores_of` has scores for, and runs none."""

    def __init__(self, scores_of):
        self._scores_of = scores_of

    def known(self, cell):
        scores = self._scores_of(cell)
        row = {"method": cell.method.name, "scene": cell.scene, "seed": cell.seed, "effort": cell.effort.label}
        row |= {"budget_s": cell.effort.budget_s, "seconds": 60.0, "revision": "abc"}
        return None if scores is None else row | scores

    def older(self, cell):
        return None


@pytest.fixture
def told_laboratory():
    """Return the class of laboratories that know results at once."""
    return ToldLaboratory
