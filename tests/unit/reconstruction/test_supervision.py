import copy
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
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.images.background import background
from reconstruction.images.composite import CompositeSource
from reconstruction.images.flicker import Light
from reconstruction.images.methods.tfp import tfp
from reconstruction.losses.counts import absolute_loss, robust_loss, square_loss
from reconstruction.methods.definition import SpikeSampling, Training
from reconstruction.rendering.render import render
from reconstruction.run.configuration import SUPERVISIONS
from reconstruction.scene_model import Rate, TimeSpan
from reconstruction.training import image_term, spike_term
from reconstruction.training.draws import Draws
from reconstruction.training.exposure import FROM, Exposure
from reconstruction.training.image_term import ImageTerm, ImageVariationTerm
from reconstruction.training.spike_term import SpikeTerm
from reconstruction.training.spike_variation_term import SpikeVariationTerm
from reconstruction.training.trainer import Trainer, TrainerSettings
from reconstruction.training.view import TrainingView
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.transform import Transform

WIDTH, HEIGHT, PLANES, RATE_HZ = 72, 56, 64, 20_000.0
LOSSES = {"l1": absolute_loss, "l2": square_loss, "counts": robust_loss, "cumulative": None}
CLIP = TimeSpan(0.0, PLANES / RATE_HZ)
CLOCK = RigClock(RATE_HZ)
STEADY = Light.steady(PLANES)
CAMERA = Camera("cam00", WIDTH, HEIGHT, 60.0, 60.0, WIDTH / 2, HEIGHT / 2, Transform.identity())


def cloud(speed: float = 0.0) -> DynamicCloud:
    """A bright wall, and a darker blob before it that crosses `speed` metres a clip."""
    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(-1.6, 1.6, 900), rng.uniform(-1.2, 1.2, 900), np.full(900, 2.0)])
    still = GaussianCloud.from_points(
        torch.tensor(wall, dtype=torch.float32), torch.full((900, 1), 0.5), torch.full((900,), 0.08).log(), 0.9
    )
    moving = GaussianCloud.from_points(
        torch.tensor([[0.0, 0.0, 1.5]]), torch.full((1, 1), 0.1), torch.full((1,), 0.12).log(), 0.95
    )
    motion = PolynomialMotion.at_rest(torch.tensor([0.5]), 100.0)
    motion.velocities[:] = torch.tensor([speed, 0.0, 0.0])
    return DynamicCloud(still, moving, motion, CLIP)


def seen(truth: DynamicCloud) -> TrainingView:
    """Record it with an ideal sensor."""
    with torch.no_grad():
        light = [render(truth.at(CLOCK.instant_s(k)), CAMERA).intensity[..., 0].numpy() for k in range(PLANES)]
    layout = PlaneLayout(WIDTH, HEIGHT)
    planes = Sensor(WIDTH, HEIGHT, "ideal", 1, 0).expose(np.stack(light))
    stream = SpikeStream(pack(planes, layout), layout, RATE_HZ)
    moving = np.abs(light[0] - light[-1]) > 0.02
    return TrainingView(CAMERA, CompositeSource(stream, background(stream, moving, STEADY), moving, tfp, STEADY))


@pytest.mark.parametrize("nodes", [1, 2, 4])
def test_the_quadrature_is_exact_for_polynomials_of_its_order(nodes):
    places, weights = image_term.quadrature(nodes)
    for power in range(2 * nodes):
        assert sum(w * p**power for p, w in zip(places, weights, strict=True)) == pytest.approx(
            1 / (power + 1), abs=1e-12
        )


def test_a_part_is_that_part_of_the_whole_view():
    truth = cloud(0.4)
    view = seen(truth)
    part = spike_term.part_with_mover(view, (32, 24), np.random.default_rng(3))
    whole, cut = render(truth.at(0.001), CAMERA), render(truth.at(0.001), part.camera)
    assert cut.intensity.shape == (24, 32, 1)
    rows, columns = slice(part.top, part.top + part.camera.height), slice(part.left, part.left + part.camera.width)
    assert np.allclose(whole.intensity[rows, columns, 0].numpy(), cut.intensity[..., 0].numpy(), atol=2e-3)


@pytest.mark.parametrize("norm", ["l1", "l2", "counts", "cumulative"])
def test_the_moving_truth_explains_its_spikes_better_than_one_that_stands(norm):
    truth, wrong = cloud(0.8), cloud(0.0)
    view = seen(truth)
    term = SpikeTerm(ImageTerm(CLOCK, 0.6), LOSSES[norm], SpikeSampling(size_px=(WIDTH, HEIGHT)))
    losses = {}
    with torch.no_grad():
        for name, model in (("true", truth), ("wrong", wrong)):
            draws = Draws(1, 0)
            losses[name] = float(torch.stack([term(model, view, draws) for _ in range(12)]).mean())
    assert losses["true"] < 0.8 * losses["wrong"]


@pytest.mark.parametrize(("planes", "stride"), [(16, 16), (8, 12), (16, 8), (1, 1)])
def test_the_moving_truth_changes_as_its_spikes_do(planes, stride):
    truth, wrong = cloud(0.8), cloud(0.0)
    view, whole = seen(truth), SpikeSampling(size_px=(WIDTH, HEIGHT))
    term = SpikeVariationTerm(ImageTerm(CLOCK, 0.6), whole, windows=5, planes=planes, stride=stride)
    with torch.no_grad():
        losses = [
            float(torch.stack([term(model, view, draws) for _ in range(24)]).mean())
            for model, draws in ((truth, Draws(1, 0)), (wrong, Draws(1, 0)))
        ]
    assert losses[0] < losses[1]


@pytest.mark.parametrize("planes", [1, 2, 3, 7])
def test_a_short_clip_has_shorter_windows_or_is_compared_as_an_image(planes):
    truth, view = cloud(0.4), seen(cloud(0.4))
    view = replace(view, source=view.source.part(0, planes))
    loss = SpikeVariationTerm(ImageTerm(CLOCK, 0.6))(truth, view, Draws(1, 0))
    assert np.isfinite(float(loss.detach()))


def test_the_integral_over_a_window_is_that_of_many_instants():
    truth = cloud(1.6)
    view = seen(truth)
    with torch.no_grad():
        light = ImageTerm(CLOCK, 0.6).over(truth, view, CAMERA, (8, 32, 4)).intensity[..., 0]
        dense = torch.stack(
            [render(truth.at(CLOCK.instant_s(k)), CAMERA).intensity[..., 0] for k in range(8, 40)]
        ).mean(dim=0)
        middle = render(truth.at(CLOCK.instant_s(23.5)), CAMERA).intensity[..., 0]
    assert float((light - dense).abs().max()) < 0.1 * float((middle - dense).abs().max())


@pytest.mark.parametrize("plane", [0, 2, 30, PLANES - 1])
def test_an_image_of_nine_planes_is_rendered_as_their_mean_where_a_mover_gets_far(plane):
    truth = cloud(0.8)
    view, exposure = seen(truth), Exposure(9, CLOCK)
    exposure.look(truth, [CAMERA], FROM)
    first, length = view.source.exposed(plane, 9)
    assert exposure.nodes == 2
    with torch.no_grad():
        both, one = (ImageTerm(CLOCK, 0.6, exposure=e).pair(truth, view, plane)[0] for e in (exposure, None))
        instants_s = [CLOCK.instant_s(k) for k in range(int(first), int(first) + length)]
        dense = torch.stack([render(truth.at(t), CAMERA).intensity for t in instants_s]).mean(dim=0)
    assert float((both.intensity - dense).abs().max()) < 0.1 * float((one.intensity - dense).abs().max())


def test_a_training_that_goes_on_knows_how_many_instants_an_image_takes():
    view, settings = seen(cloud(0.8)), TrainerSettings("pixels", Training(deblurs=True), image_planes=9)
    one, two = (Trainer(cloud(0.8), [view], settings, CLOCK, seed=0) for _ in range(2))
    assert one.exposure is not None
    assert two.exposure is not None
    one.step(0.4)
    assert one.exposure.passed_px is None
    one.step(0.5)
    two.restore(copy.deepcopy(one.state()))
    assert two.exposure.passed_px == one.exposure.passed_px
    assert two.exposure.nodes == 2
    assert [two.step(0.6), two.step(0.7)] == [one.step(0.6), one.step(0.7)]


@pytest.mark.parametrize("supervised", list(SUPERVISIONS))
def test_every_supervision_moves_a_displaced_mover_back(supervised, monkeypatch):
    monkeypatch.setitem(GaussianCloud.rates, "means", Rate(4e-3, "scene"))
    view = seen(cloud(0.0))
    model = cloud(0.0)
    model.moving.means[:] += torch.tensor([0.05, 0.0, 0.0])
    trainer = Trainer(model, [view], TrainerSettings(supervised), CLOCK, seed=0)
    for step in range(30):
        assert np.isfinite(trainer.step(0.2 + step / 100))
    assert abs(float(model.moving.means.detach()[0, 0])) < 0.04


def test_spikes_alone_teach_whole_views_from_the_first_step(monkeypatch):
    view, model = seen(cloud(0.0)), cloud(0.0)
    model.moving.means[:] += torch.tensor([0.05, 0.0, 0.0])
    monkeypatch.setitem(GaussianCloud.rates, "means", Rate(4e-3, "scene"))
    settings = TrainerSettings("counts", Training(spikes=SpikeSampling(1, (8, 64), None)))
    trainer, sizes = Trainer(model, [view], settings, CLOCK, seed=0), []
    part_of = spike_term.part_with_mover
    monkeypatch.setattr(spike_term, "part_with_mover", lambda *a: sizes.append(part_of(*a).camera.width) or part_of(*a))
    monkeypatch.setattr(ImageTerm, "__call__", lambda *_: pytest.fail("an image was compared"))
    for step in range(30):
        trainer.step(step / 100)
    assert sizes == [WIDTH] * 30
    assert abs(float(model.moving.means.detach()[0, 0])) < 0.04


@pytest.mark.parametrize("norm", ["counts", "cumulative"])
def test_what_never_changes_is_rendered_once_for_a_window(norm, monkeypatch):
    view, still = seen(cloud(0.0)), cloud(0.0)
    motionless = PolynomialMotion.at_rest(torch.zeros(0), 1.0)
    still = DynamicCloud(still.still, still.moving.select(torch.arange(0)), motionless, CLIP)
    term, renders = SpikeTerm(ImageTerm(CLOCK, 0.6), LOSSES[norm], SpikeSampling(planes=(32, 33), size_px=None)), []
    monkeypatch.setattr(image_term, "render", lambda *a, **k: renders.append(a) or render(*a, **k))
    term(still, view, Draws(1, 0))
    assert len(renders) == (1 if norm == "counts" else 4)


def test_a_clip_shorter_than_any_window_is_used_whole():
    view = seen(cloud(0.0))
    short = SpikeStream(view.source.stream.packed[:5], view.source.stream.layout, RATE_HZ)
    view = TrainingView(CAMERA, replace(view.source, stream=short))
    for term in (SpikeTerm(ImageTerm(CLOCK, 0.6), robust_loss), ImageVariationTerm(ImageTerm(CLOCK, 0.6))):
        assert torch.isfinite(term(cloud(0.0), view, Draws(1, 0)))


def test_a_view_that_sees_no_mover_is_supervised_anywhere():
    view = seen(cloud(0.0))
    view = TrainingView(CAMERA, replace(view.source, moving=np.zeros((HEIGHT, WIDTH), dtype=bool)))
    part = spike_term.part_with_mover(view, (1000, 1000), np.random.default_rng(0))
    assert (part.top, part.left, part.camera.width, part.camera.height) == (0, 0, WIDTH, HEIGHT)


def test_with_a_weight_a_step_has_the_loss_on_images_and_the_weighted_one_on_spikes(monkeypatch):
    def losses(**settings):
        trainer = Trainer(cloud(0.0), [seen(cloud(0.0))], TrainerSettings("counts", **settings), CLOCK, seed=0)
        image, spikes = torch.tensor(2.0, requires_grad=True), torch.tensor(3.0, requires_grad=True)
        trainer.image = lambda *_: image * 1
        trainer.spikes = lambda *_: spikes * 1
        return [trainer.step(0.5) for _ in range(4)]

    assert losses() == [2.0, 3.0, 2.0, 3.0]
    assert losses(spike_weight=0.5) == [2.0, 3.5, 2.0, 3.5]
    assert losses(spike_weight=0.0) == [2.0, 2.0, 2.0, 2.0]


@pytest.mark.parametrize("term", ["counts", "cumulative", "variation"])
def test_terms_on_spikes_leave_empty_places_empty(term):
    """Ask for less opacity where nothing is, and for more elsewhere."""
    dark = cloud()
    for part in (dark.still, dark.moving):
        part.intensities = torch.zeros_like(part.intensities)
        part.opacity_logits = torch.zeros_like(part.opacity_logits).requires_grad_()
    view, image = seen(dark), ImageTerm(CLOCK, 0.6)
    made = SpikeVariationTerm(image) if term == "variation" else SpikeTerm(image, LOSSES[term])
    pulls = []
    for empty in (None, torch.zeros(HEIGHT, WIDTH), torch.ones(HEIGHT, WIDTH)):
        dark.still.opacity_logits.grad = None
        made(dark, replace(view, empty=empty), Draws(1, 3)).backward()
        pulls.append(dark.still.opacity_logits.grad)
    assert torch.equal(pulls[0], pulls[1])
    assert pulls[0].sum() < 0 < pulls[2].sum()
