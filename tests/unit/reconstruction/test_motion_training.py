"""Training with every motion model: exact resume, what is learnt and what is not, and a mover brought back."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import MODELS, DynamicCloud
from reconstruction.gaussians.hexplane import HexPlaneMotion, SmallHexPlaneMotion, box_around
from reconstruction.gaussians.motion_model import MotionModel
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spacetime import SpacetimeMotion
from reconstruction.gaussians.timesteps import TimestepMotion
from reconstruction.images.background import FULL_WHITE, background
from reconstruction.images.composite import CompositeSource
from reconstruction.images.flicker import Light
from reconstruction.images.methods.tfp import tfp
from reconstruction.methods.definition import Training
from reconstruction.rendering.render import render
from reconstruction.scene_model import Rate, TimeSpan
from reconstruction.tensors import write_tensors
from reconstruction.training.averaging import EVERY
from reconstruction.training.checkpoint import load_checkpoint
from reconstruction.training.image_term import ImageTerm
from reconstruction.training.optimizer import states_of
from reconstruction.training.regrouping import bodies_of
from reconstruction.training.trainer import LIVING_EVERY, Trainer, TrainerSettings
from reconstruction.training.view import TrainingView
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.transform import Transform

WIDTH, HEIGHT, PLANES, RATE_HZ = 48, 40, 48, 20_000.0
CLIP, CLOCK = TimeSpan(0.0, PLANES / RATE_HZ), RigClock(RATE_HZ)
CAMERA = Camera("cam00", WIDTH, HEIGHT, 40.0, 40.0, WIDTH / 2, HEIGHT / 2, Transform.identity())
KINDS = ("polynomial", "bases", "4dgs", "stg", "d3dgs", "4dgs-small")


def motion_of(kind: str, means: torch.Tensor, speed: float) -> MotionModel:
    """Both Gaussians along x at `speed` metres a clip (the field is at rest: it knows no speed)."""
    instants = torch.full((2,), 0.5)
    if kind == "polynomial":
        motion = PolynomialMotion.at_rest(instants, 100.0)
        motion.velocities[:, 0] = speed
        return motion
    if kind == "stg":
        motion = SpacetimeMotion.started(instants, 100.0)
        motion.velocities[:, 0] = speed
        return motion
    if kind == "d3dgs":
        return TimestepMotion.started(means)
    if kind in ("4dgs", "4dgs-small"):
        model = HexPlaneMotion if kind == "4dgs" else SmallHexPlaneMotion
        return model.over(box_around(means, 0.3), torch.Generator().manual_seed(0), 0.1)
    quats = torch.tensor([1.0, 0, 0, 0]).expand(1, 5, 4).clone()
    centers = torch.stack([speed * torch.linspace(-0.5, 0.5, 5), *torch.zeros(2, 5)], dim=-1)[None]
    return RigidMotion(torch.zeros(2, dtype=torch.int64), quats, centers, torch.zeros(0, 3), instants, instants * 8)


def cloud(kind: str, speed: float = 0.0) -> DynamicCloud:
    """A bright wall, and two dark blobs before it."""
    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(-1.6, 1.6, 400), rng.uniform(-1.2, 1.2, 400), np.full(400, 2.0)])
    still = GaussianCloud.from_points(
        torch.tensor(wall, dtype=torch.float32), torch.full((400, 1), 0.5), torch.full((400,), 0.12).log(), 0.9
    )
    at = torch.tensor([[0.0, -0.1, 1.5], [0.1, 0.2, 1.5]])
    moving = GaussianCloud.from_points(at, torch.full((2, 1), 0.1), torch.full((2,), 0.12).log(), 0.95)
    return DynamicCloud(still, moving, motion_of(kind, at, speed), CLIP)


@pytest.fixture(scope="module")
def view() -> TrainingView:
    return recorded_view()


def recorded_view(truth: DynamicCloud | None = None) -> TrainingView:
    """Record a scene, by default blobs that cross 60 cm, with an ideal sensor."""
    truth = truth or cloud("polynomial", 0.6)
    with torch.no_grad():
        light = [render(truth.at(CLOCK.instant_s(k)), CAMERA).intensity[..., 0].numpy() for k in range(PLANES)]
    layout = PlaneLayout(WIDTH, HEIGHT)
    stream = SpikeStream(pack(Sensor(WIDTH, HEIGHT, "ideal", 1, 0).expose(np.stack(light)), layout), layout, RATE_HZ)
    moving = np.abs(light[0] - light[-1]) > 0.02
    return TrainingView(
        CAMERA,
        CompositeSource(stream, background(stream, moving, Light.steady(PLANES)), moving, tfp, Light.steady(PLANES)),
    )


def trainer_of(kind: str, view: TrainingView, speed: float = 0.0) -> Trainer:
    return Trainer(cloud(kind, speed), [view], TrainerSettings("pixels", Training(canonical_until=0.3)), CLOCK, seed=1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_training_stopped_and_resumed_ends_in_the_same_state(kind, view, tmp_path):
    whole, first = trainer_of(kind, view), trainer_of(kind, view)
    for step in range(8):
        whole.step(step / 8)
        if step < 5:
            first.step(step / 8)
    write_tensors(tmp_path / "state.pt", {"trainer": first.state()})
    second = trainer_of(kind, view)
    second.restore(load_checkpoint(tmp_path / "state.pt")["trainer"])
    for step in range(5, 8):
        second.step(step / 8)
    for one, other in ((whole.cloud, second.cloud), (whole.result(), second.result())):
        for (name, a), (_, b) in zip(one.tensors(), other.tensors(), strict=True):
            assert torch.equal(a, b), name


def test_what_is_found_is_the_mean_of_the_steps_and_settles_in_the_cloud(view):
    trainer = trainer_of("linear", view)
    for step in range(EVERY):
        trainer.step(step / EVERY)
    assert torch.equal(trainer.result().still.means, trainer.cloud.still.means)  # one look, at the last step
    for step in range(300):
        trainer.step(step / 300)
    found = trainer.result()
    assert not torch.equal(found.still.means, trainer.cloud.still.means)
    trainer.settle()
    for (name, a), (_, b) in zip(found.tensors(), trainer.cloud.tensors(), strict=True):
        assert torch.equal(a, b), name


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "d3dgs"])  # learns in timesteps: test_timestep_motion
def test_everything_is_learnt_but_what_is_fixed(kind, view):
    trainer = trainer_of(kind, view, speed=0.1)
    before = {name: t.detach().clone() for name, t in trainer.cloud.tensors()}
    for step in range(6):
        assert np.isfinite(trainer.step(0.4 + step / 20))
    for name, tensor in trainer.cloud.tensors():
        fixed = name not in trainer.cloud.rates()
        assert tensor.numel() == 0 or torch.equal(before[name], tensor) == fixed, name


@pytest.mark.parametrize("kind", ["4dgs", "4dgs-small"])
def test_the_canonical_stage_leaves_the_field_alone(kind, view):
    trainer = trainer_of(kind, view)
    before = {name: t.detach().clone() for name, t in trainer.cloud.tensors()}
    for _ in range(3):
        trainer.step(0.2)
    for name, tensor in trainer.cloud.tensors():
        assert torch.equal(before[name], tensor) == name.startswith("motion."), name


@pytest.mark.parametrize("kind", ["bases", pytest.param("4dgs", marks=pytest.mark.slow), "4dgs-small"])
def test_a_motion_is_learnt_from_standing_still(kind, view, monkeypatch):
    monkeypatch.setitem(RigidMotion.rates, "knot_centers", Rate(6e-3, "scene"))  # fast, for sixty steps
    for planes in ("coarse_space", "coarse_time", "fine_space", "fine_time"):
        for model in (HexPlaneMotion, SmallHexPlaneMotion):
            monkeypatch.setitem(model.rates, planes, Rate(5e-2, deforms=True))
    trainer = trainer_of(kind, view)
    trainer = Trainer(trainer.cloud, [view], TrainerSettings("pixels", Training(canonical_until=0.0)), CLOCK, seed=1)
    for _ in range(150 if kind == "4dgs" else 60):  # its fine cells of time begin slowly
        trainer.step(0.2)
    now, then = (trainer.cloud.at(u * CLIP.last_s).means[-2:, 0].detach() for u in (0.9, 0.1))
    assert float((now - then).max()) > 0.15  # of 0.48


def test_pictures_are_small_until_the_last_doubling(view, monkeypatch):
    settings, sizes = (
        TrainerSettings("pixels", Training(canonical_until=0.0), ends_early=True, doublings=(0.25, 0.5)),
        [],
    )
    trainer = Trainer(cloud("polynomial"), [view], settings, CLOCK, seed=1)

    def seen(loss, view, rendered, target):
        sizes.append(tuple(target.shape))
        return held(loss, view, rendered, target)

    held = ImageTerm.held
    monkeypatch.setattr(ImageTerm, "held", seen)
    before = trainer.cloud.still.intensities.detach().clone()
    for done in (0.0, 0.24, 0.25, 0.49, 0.5, 0.99):
        assert np.isfinite(trainer.step(done))
    quarter, half = (HEIGHT // 4, WIDTH // 4), (HEIGHT // 2, WIDTH // 2)
    assert sizes == [quarter, quarter, half, half, (HEIGHT, WIDTH), (HEIGHT, WIDTH)]
    assert not torch.equal(before, trainer.cloud.still.intensities)
    assert trainer.ending is not None
    assert sum(trainer.ending.counts) == 2  # losses of small pictures are others


@pytest.mark.parametrize("alive", [True, False])
def test_a_training_with_nothing_left_to_see_stops_with_the_reason(alive, view):
    trainer = trainer_of("polynomial", view)
    with torch.no_grad():
        trainer.cloud.still.opacity_logits.fill_(-20.0)
        trainer.cloud.moving.opacity_logits.fill_(0.0 if alive else -20.0)
    trainer.steps = LIVING_EVERY - 1
    if alive:
        assert trainer.step(0.3) > 0
        return
    with pytest.raises(ReconstructionError, match=r"found no Gaussians of opacity 0\.005 or more after 100 steps"):
        trainer.step(0.3)


def test_a_step_of_light_is_smaller_in_a_dim_scene(view):
    bright, dim = (Trainer(cloud("linear"), [view], TrainerSettings("pixels", white=w), CLOCK, 0) for w in (0.5, 0.01))
    rates = [{group["start"] for group in t.optimizer.param_groups} for t in (bright, dim)]
    own = GaussianCloud.rates["intensities"].start
    assert rates[0] - rates[1] == {own}
    assert rates[1] - rates[0] == {own * (0.01 / FULL_WHITE)}


@pytest.mark.parametrize("kind", MODELS)
def test_every_model_says_which_of_its_tensors_are_learnt(kind):
    fixed = {
        "bases": {"bodies"},
        "4dgs": {"box", "brightness"},
        "4dgs-small": {"box", "brightness"},
        "d3dgs": {"past_means", "past_quats", "current", "indices", "weights", "distances"},
    }
    names = {field.name for field in fields(MODELS[kind])}
    assert names - MODELS[kind].rates.keys() == fixed.get(kind, set())
    assert MODELS[kind].rates.keys() <= names


def strips(speeds: tuple[float, float]) -> DynamicCloud:
    """Two dark strips of 20 Gaussians that touch, each on a part of its own, at so many metres a clip along x."""
    strip = torch.stack([torch.linspace(-0.2, 0.2, 20), torch.zeros(20), torch.full((20,), 1.5)], dim=-1)
    places = torch.cat([strip, strip + torch.tensor([0.0, 0.1, 0.0])])
    quats, centers = torch.tensor([1.0, 0, 0, 0]).expand(2, 5, 4).clone(), torch.zeros(2, 5, 3)
    for part, speed in enumerate(speeds):
        centers[part, :, 0] = speed * torch.linspace(-0.5, 0.5, 5)
    moving = GaussianCloud.from_points(places, torch.full((40, 1), 0.1), torch.full((40,), 0.04).log(), 0.9)
    always = torch.full((40,), 0.5), torch.full((40,), 4.0)
    return replace(
        cloud("bases"),
        moving=moving,
        motion=RigidMotion(torch.arange(40) // 20, quats, centers, torch.zeros(0, 3), *always),
    )


def trainer_of_parts(view: TrainingView, speeds: tuple[float, float]) -> Trainer:
    return Trainer(strips(speeds), [view], TrainerSettings("pixels"), CLOCK, seed=1)


@pytest.mark.parametrize(("speeds", "bodies"), [((0.4, 0.4), 1), ((0.4, -0.4), 2), ((-0.1, 0.4), 2)])
def test_parts_of_what_was_taken_for_one_body_at_rest_find_their_motions(speeds, bodies, monkeypatch):
    """They touch all the time, and are plain: only pictures tell. Ten seeds of the training find the same bodies."""
    monkeypatch.setitem(RigidMotion.rates, "knot_centers", Rate(6e-3, "scene"))  # fast, for eighty steps
    view, start = recorded_view(strips(speeds)), strips((0.0, 0.0)).state()
    for seed in range(10):
        trainer = Trainer(DynamicCloud.from_state(start), [view], TrainerSettings("pixels"), CLOCK, seed)
        for _ in range(80):
            trainer.step(0.2)
        trainer.step(0.25)
        assert trainer.joined == (2, bodies)


@pytest.mark.parametrize(("speeds", "bodies"), [((0.6, 0.6), 1), ((0.6, -0.6), 2)])
def test_parts_that_move_alike_are_one_body_from_a_quarter_on(speeds, bodies, view):
    trainer = trainer_of_parts(view, speeds)
    for _ in range(4):
        trainer.step(0.2)
    known = {name: state["exp_avg_sq"].clone() for name, state in states_of(trainer.optimizer, trainer.cloud).items()}
    assert trainer.joined is None
    before = trainer.cloud.movers(CLIP.middle_s)[0].detach()
    trainer._join()
    assert trainer.joined == (2, bodies)
    assert bodies_of(trainer.cloud) == bodies
    torch.testing.assert_close(trainer.cloud.movers(CLIP.middle_s)[0].detach(), before, atol=1e-4, rtol=0)
    for name, tensor in trainer.cloud.tensors():
        if name in known:
            squares = trainer.optimizer.state[tensor]["exp_avg_sq"]
            as_before = known[name].sum(dim=0, keepdim=True) if len(squares) < len(known[name]) else known[name]
            assert torch.equal(squares, as_before), name
    for _ in range(4):
        assert np.isfinite(trainer.step(0.3))
    assert trainer.joined == (2, bodies)


@pytest.mark.parametrize("stop", [1, 2, 3])
def test_a_training_stopped_around_the_joining_ends_in_the_same_state(stop, view, tmp_path):
    whole, first, second = (trainer_of_parts(view, (0.6, 0.6)) for _ in range(3))
    for step in range(8):
        whole.step(step / 8)
        if step < stop:
            first.step(step / 8)
    write_tensors(tmp_path / "state.pt", {"trainer": first.state()})
    second.restore(load_checkpoint(tmp_path / "state.pt")["trainer"])
    for step in range(stop, 8):
        second.step(step / 8)
    assert whole.joined == second.joined == (2, 1)
    for (name, a), (_, b) in zip(whole.cloud.tensors(), second.cloud.tensors(), strict=True):
        assert torch.equal(a, b), name


def test_a_training_that_is_over_at_once_joins_before_its_only_step(view):
    trainer = trainer_of_parts(view, (0.6, 0.6))
    assert np.isfinite(trainer.step(1.0))
    assert trainer.joined == (2, 1)
