"""The watch: what it sees that the plan does not, what it leaves alone, and Gaussians that become moving ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion, box_around
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spacetime import SpacetimeMotion
from reconstruction.images.background import background, moving_pixels
from reconstruction.images.composite import CompositeSource
from reconstruction.images.flicker import Light, estimate_light
from reconstruction.images.methods.tfp import tfp
from reconstruction.rendering.render import render
from reconstruction.scene_model import TimeSpan
from reconstruction.tensors import write_tensors
from reconstruction.training.changed_pixels import changed_pixels, look_again, unsettled
from reconstruction.training.checkpoint import load_checkpoint
from reconstruction.training.ending import Ending
from reconstruction.training.freeing import freed
from reconstruction.training.trainer import Trainer, TrainerSettings
from reconstruction.training.view import TrainingView
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.transform import Transform

WIDTH, HEIGHT, PLANES, RATE_HZ = 64, 48, 320, 20_000.0
CLIP, CLOCK = TimeSpan(0.0, PLANES / RATE_HZ), RigClock(RATE_HZ)
CAMERA = Camera("cam00", WIDTH, HEIGHT, 50.0, 50.0, WIDTH / 2, HEIGHT / 2, Transform.identity())
PATCH = (slice(10, 26), slice(20, 36))
STEADY = Light.steady(PLANES)


def recorded(light: np.ndarray) -> SpikeStream:
    """Record light [T, H, W] with a real sensor."""
    layout = PlaneLayout(WIDTH, HEIGHT)
    spikes = Sensor(WIDTH, HEIGHT, "real", 1, 0).expose(light.astype(np.float32))
    return SpikeStream(pack(spikes, layout), layout, RATE_HZ)


def scene(brighter: float = 0.0) -> np.ndarray:
    """A textured wall, on which a patch is `brighter` for 32 planes."""
    wall = np.random.default_rng(0).uniform(0.1, 0.6, (HEIGHT, WIDTH))
    light = np.repeat(wall[None], PLANES, axis=0)
    light[(slice(96, 128), *PATCH)] += brighter
    return light


def test_a_faint_brief_change_is_seen_that_the_plan_misses():
    stream = recorded(scene(0.07))
    assert not moving_pixels(stream, STEADY).any()
    changed = changed_pixels(stream, np.ones((HEIGHT, WIDTH), bool), STEADY)
    inside = np.zeros_like(changed)
    inside[PATCH] = True
    assert changed[inside].mean() > 0.9
    assert changed[~inside].mean() < 0.1


@pytest.mark.parametrize("flicker", [0.0, 0.3])
def test_nothing_is_seen_where_nothing_moves(flicker):
    waves = 1 + flicker * np.sin(2 * np.pi * np.arange(PLANES) / 200)
    stream = recorded(scene() * waves[:, None, None])
    light = estimate_light([stream])
    assert light.flickers == (flicker > 0)
    assert not changed_pixels(stream, np.ones((HEIGHT, WIDTH), bool), light).any()


def test_pixels_that_move_by_plan_are_not_asked_again():
    stream, still = recorded(scene(0.3)), np.ones((HEIGHT, WIDTH), bool)
    assert changed_pixels(stream, still, STEADY).any()
    still[6:30, 16:40] = False
    assert not changed_pixels(stream, still, STEADY).any()


def test_gaussians_are_judged_by_most_of_the_views_that_see_them():
    cameras = [replace(CAMERA, id=f"cam{i}") for i in range(3)]
    left = np.zeros((HEIGHT, WIDTH), bool)
    left[:, : WIDTH // 2] = True
    means = torch.tensor([[-0.2, 0.0, 1.0], [0.2, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert unsettled(means, cameras, {0: left, 2: left}).tolist() == [True, False, False]
    assert unsettled(means, cameras, {0: left}).tolist() == [False, False, False]


def gaussians(count: int) -> GaussianCloud:
    means = torch.from_numpy(np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)) * 0.2
    means[:, 2] += 1
    return GaussianCloud.from_points(means, torch.full((count, 1), 0.4), torch.full((count,), 0.05).log(), 0.9)


def motion_of(kind: str, moving: GaussianCloud):
    count = len(moving)
    instants = torch.full((count,), 0.3)
    if kind == "bases":
        quats, centers = torch.tensor([1.0, 0, 0, 0]).expand(1, 3, 4).clone(), torch.zeros(1, 3, 3)
        owners = torch.zeros(count - 1, dtype=torch.int64)
        return RigidMotion(owners, quats, centers, torch.zeros(1, 3), instants, instants * 0)
    if kind == "stg":
        return SpacetimeMotion.started(instants, 0.2)
    if kind == "4dgs":
        return HexPlaneMotion.over(box_around(moving.means, 0.3), torch.Generator().manual_seed(0))
    return PolynomialMotion.at_rest(instants, 0.2, cubic=kind == "cubic")


@pytest.mark.parametrize("kind", ["linear", "cubic", "bases", "4dgs", "stg"])
def test_freed_gaussians_stay_where_they_are_at_first(kind):
    moving = gaussians(4)
    cloud = DynamicCloud(gaussians(9), moving, motion_of(kind, moving), CLIP)
    which = torch.arange(9) % 3 == 0
    after = freed(cloud, which)
    assert (len(after.still), len(after.moving)) == (6, 7)
    with torch.no_grad():
        for u in (0.1, 0.5, 0.8):
            found = after.at(u * CLIP.last_s)
            before = cloud.at(u * CLIP.last_s)
            assert torch.allclose(found.means[-3:], cloud.still.means[which], atol=1e-6)
            assert torch.equal(found.means[6:10], before.means[9:13])
            assert (found.opacities[-3:] > 0.85).all()


def test_a_static_cloud_takes_them_too():
    none = gaussians(3).select(torch.zeros(3, dtype=torch.bool))
    after = freed(DynamicCloud(gaussians(9), none, motion_of("linear", none), CLIP), torch.arange(9) < 2)
    assert (len(after.still), len(after.moving)) == (7, 2)


@pytest.fixture(scope="module")
def missed() -> TrainingView:
    """A view in which a dark blob covers a part of the wall from mid-clip on, all of it taken for still."""
    blob = np.zeros((PLANES, HEIGHT, WIDTH), bool)
    blob[(slice(PLANES // 2, None), *PATCH)] = True
    stream = recorded(np.where(blob, 0.02, scene()))
    none = np.zeros((HEIGHT, WIDTH), bool)
    return TrainingView(CAMERA, CompositeSource(stream, background(stream, none, STEADY), none, tfp, STEADY))


def trainer_of(view: TrainingView) -> Trainer:
    """A wall of Gaussians, none of which moves."""
    y, x = np.mgrid[-20:20:2, -28:28:2] / 50
    means = torch.tensor(np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]), dtype=torch.float32)
    lit, wide = torch.full((x.size, 1), 0.3), torch.full((x.size,), 0.02).log()
    still, none = GaussianCloud.from_points(means, lit, wide, 0.9), gaussians(3).select(torch.arange(0))
    return Trainer(
        DynamicCloud(still, none, motion_of("linear", none), CLIP), [view], TrainerSettings("pixels"), CLOCK, 1
    )


def undone(trainer: Trainer) -> np.ndarray:
    """Undo what the watch finds in the one view of `trainer`; the pixels."""
    (view,), found = trainer.views, look_again(trainer.views)
    which = unsettled(trainer.cloud.still.means, [CAMERA], found)
    source = replace(view.source, moving=view.source.moving | found[0], kept={})
    trainer.unsettle([replace(view, source=source)], which)
    return found[0]


def error(trainer: Trainer, stream: SpikeStream, pixels: np.ndarray) -> float:
    """Mean distance of the render from 33-plane means at six instants, over `pixels`."""
    gaps = []
    for plane in range(30, PLANES, 50):
        with torch.no_grad():
            light = render(trainer.cloud.at(CLOCK.instant_s(plane)), CAMERA).intensity[..., 0].numpy()
        gaps.append(np.abs(light - tfp(stream, plane).intensity)[pixels].mean())
    return float(np.mean(gaps))


def test_a_mover_the_plan_missed_is_learnt_after_the_watch(missed):
    blind, watched = trainer_of(missed), trainer_of(missed)
    for trainer in (blind, watched):
        for step in range(30):
            trainer.step(0.2 + step / 300)
    watched.ending = Ending(1, windows=[1.0, 1.0], totals=[3.0], counts=[2])
    pixels = undone(watched)
    assert watched.ending == Ending(1)  # windows of other targets say nothing
    assert pixels[PATCH].mean() > 0.9
    for trainer in (blind, watched):
        for step in range(150):
            trainer.step(0.3 + step / 300)
    found, before = (error(trainer, missed.source.stream, pixels) for trainer in (watched, blind))
    assert found < 0.8 * before


def test_moments_are_carried_over_and_a_resumed_training_is_the_same(missed, tmp_path):
    whole = trainer_of(missed)
    for _ in range(5):
        whole.step(0.3)
    still = whole.cloud.still.means
    old = whole.optimizer.state[still]["exp_avg"].clone()
    which = unsettled(still, [CAMERA], look_again(whole.views))
    undone(whole)
    assert torch.equal(whole.optimizer.state[whole.cloud.still.means]["exp_avg"], old[~which])
    assert torch.equal(whole.optimizer.state[whole.cloud.moving.means]["exp_avg"], old[which])
    for _ in range(3):
        whole.step(0.3)
    write_tensors(tmp_path / "state.pt", whole.state())
    resumed = trainer_of(whole.views[0])
    resumed.restore(load_checkpoint(tmp_path / "state.pt"))
    for trainer in (whole, resumed):
        for _ in range(4):
            trainer.step(0.4)
    for (name, a), (_, b) in zip(whole.cloud.tensors(), resumed.cloud.tensors(), strict=True):
        assert torch.equal(a, b), name
