"""A scene of spans: which of them is shown, what it changes, what is learnt of one, and its state."""

import pytest
import torch

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import UNSAID_PX2, DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.spanned import SpanCloud, SpanContent, SpannedScene, nothing
from reconstruction.rendering.render import render
from reconstruction.rendering.result import GUARDS
from reconstruction.scene_model import TimeSpan
from reconstruction.training.checkpoint import model_from_state
from reconstruction.training.optimizer import optimizer_of
from rigs.camera import Camera
from rigs.transform import Transform

CAMERA = Camera("cam11", 48, 40, 50.0, 48.0, 24.0, 20.0, Transform.identity())
SPANS = [TimeSpan(0.1 * i, 0.1 * (i + 1)) for i in range(3)]


def gaussians(count: int, seed: int = 0) -> GaussianCloud:
    generator = torch.Generator().manual_seed(seed)
    places = torch.rand(count, 3, generator=generator) - 0.5 + torch.tensor([0.0, 0.0, 2.0])
    light = torch.rand(count, 1, generator=generator)
    return GaussianCloud.from_points(places, light, torch.full((count,), -3.0), 0.6)


def movers(count: int, clip: TimeSpan) -> DynamicCloud:
    motion = PolynomialMotion.at_rest(torch.full((count,), 0.5), 2.0)
    return DynamicCloud(nothing(), gaussians(count, 7), motion, clip)


def scene() -> SpannedScene:
    changed = SpanContent(SPANS[2], torch.tensor([1, 4]), torch.tensor([-9.0, -9.0]), torch.zeros(2, 1))
    with_movers = SpanContent.as_usual(SPANS[1])
    with_movers.cloud = movers(5, TimeSpan(0.09, 0.21))
    return SpannedScene(gaussians(10), [SpanContent.as_usual(SPANS[0]), with_movers, changed], TimeSpan(0.0, 0.3))


@pytest.mark.parametrize(
    ("instant_s", "number"), [(-1.0, 0), (0.0, 0), (0.0999, 0), (0.1, 1), (0.15, 1), (0.2, 2), (0.3, 2), (9.0, 2)]
)
def test_an_instant_lies_in_one_span(instant_s, number):
    assert scene().number_at(instant_s) == number


def test_each_span_shows_its_own():
    one = scene()
    assert len(one.at(0.05).means) == 10
    assert len(one.at(0.15).means) == 15
    later = one.at(0.25)
    assert len(later.means) == 10
    assert (later.opacities[[1, 4]] < 1e-3).all()
    assert (later.opacities[[0, 2, 3, 5]] > 0.5).all()
    assert len(one) == 15
    assert len(one.moving) == 5
    assert one.changes


def test_changes_of_a_span_leave_the_still_scene_alone():
    one = scene()
    before = one.still.opacity_logits.clone()
    one.at(0.25)
    assert torch.equal(one.still.opacity_logits, before)


def test_it_is_looked_at_and_has_movers_where_the_span_has():
    one = scene()
    assert len(one.movers(0.15)[0]) == 5
    assert len(one.movers(0.05)[0]) == 0
    view = one.look(CAMERA, 0.15)
    alone = one.part(1).look(CAMERA, 0.15)
    assert (view.intensity == alone.intensity).all()
    assert one.positions(0.15).shape == (15, 3)
    assert one.opacity().shape == (15,)


def test_light_that_flickers_is_that_of_the_span():
    one = scene()
    gains = torch.cat([torch.full((10,), g) for g in (1.0, 2.0, 3.0)])
    flickering = SpannedScene(one.still, [SpanContent.as_usual(clip) for clip in SPANS], one.clip, gains)
    steady = one.still.intensities
    for i, factor in enumerate((1.0, 2.0, 3.0)):
        assert torch.allclose(flickering.at(0.1 * i + 0.05).intensities, factor * steady)


def test_state_round_trips():
    one = scene()
    again = model_from_state(one.state())
    assert isinstance(again, SpannedScene)
    for (name, a), (other, b) in zip(one.tensors(), again.tensors(), strict=True):
        assert name == other
        assert a.dtype == b.dtype
        assert torch.allclose(a.float(), b.float(), rtol=1e-3, atol=1e-6)
    assert [span.clip for span in again.spans] == SPANS
    for (_, a), (_, b) in zip(again.tensors(), model_from_state(again.state()).tensors(), strict=True):
        assert torch.equal(a, b)


def test_a_state_holds_extremes_and_shows_the_same_picture():
    one = scene()
    assert one.spans[1].cloud is not None
    one.spans[1].cloud.moving.opacity_logits[:2] = torch.tensor([1e9, -1e9])
    again = model_from_state(one.state())
    assert isinstance(again, SpannedScene)
    assert all(tensor.isfinite().all() for _, tensor in again.tensors())
    shown, expected = (scene.look(CAMERA, 0.15).intensity for scene in (again, one))
    assert abs(shown - expected).max() < 1e-3


def test_a_scene_is_shown_by_the_dilation_that_it_was_learnt_by():
    one = scene()
    state = one.state()
    assert state.pop("dilation_px2") == GUARDS.dilation_px2
    earlier = model_from_state(state)
    assert isinstance(earlier, SpannedScene)
    for number, instant_s in ((0, 0.05), (1, 0.15)):
        sharp, broad = (shown.part(number).look(CAMERA, instant_s).intensity for shown in (one, earlier))
        for found, dilation_px2 in ((sharp, GUARDS.dilation_px2), (broad, UNSAID_PX2)):
            expected = render(one.at(instant_s), CAMERA, dilation_px2=dilation_px2).intensity[..., 0]
            assert torch.allclose(torch.from_numpy(found), expected, atol=2e-3)
        assert abs(sharp - broad).max() > 0.02
    assert SpannedScene.over(earlier, TimeSpan(0.0, 0.15)).dilation_px2 == UNSAID_PX2


def test_a_state_that_lacks_something_is_refused():
    state = scene().state()
    del state["still"]
    with pytest.raises(ReconstructionError, match="a scene of spans that lacks something"):
        SpannedScene.from_state(state)


def test_no_span_and_another_device_are_refused():
    with pytest.raises(ReconstructionError, match="a scene of no span"):
        SpannedScene(gaussians(2), [], TimeSpan(0.0, 1.0))
    with pytest.raises(ReconstructionError, match="float32 on the processor"):
        scene().to(torch.float64)


def learning() -> SpanCloud:
    motion = PolynomialMotion.at_rest(torch.full((4,), 0.5), 2.0)
    return SpanCloud(gaussians(3, 1), gaussians(4, 2), motion, SPANS[0], common=gaussians(6, 3))


def test_a_span_learns_movers_and_the_light_and_presence_of_its_still_gaussians():
    cloud = learning()
    names = {name for name in cloud.rates() if name.startswith("still.")}
    assert names == {"still.opacity_logits", "still.intensities"}
    optimizer_of(cloud, {"none": 1.0, "scene": 1.0, "light": 1.0})
    assert not any(tensor.requires_grad for tensor in vars(cloud.common).values())
    seen = render(cloud.at(0.05), CAMERA, given=cloud.given)
    seen.intensity.sum().backward()
    assert cloud.still.opacity_logits.grad is not None
    assert cloud.still.means.grad is None
    assert cloud.moving.means.grad is not None
    assert (cloud.given, len(cloud), len(cloud.opacity())) == (6, 13, 13)


def test_what_a_span_has_learnt_is_shown_as_it_was_learnt():
    cloud, still = learning(), gaussians(9, 4)
    changed = torch.tensor([0, 5, 8])
    for name in vars(still):
        getattr(still, name)[changed] = getattr(cloud.still, name)
        others = torch.tensor([1, 2, 3, 4, 6, 7])
        getattr(still, name)[others] = getattr(cloud.common, name)
    cloud.still.opacity_logits[1] = -9.0
    content = SpanContent.of(SPANS[0], changed, cloud)
    shown = SpannedScene(still, [content], SPANS[0])
    a, b = (one.look(CAMERA, 0.05) for one in (shown, cloud))
    assert torch.allclose(torch.from_numpy(a.intensity), torch.from_numpy(b.intensity), atol=1e-6)
    assert shown.part(0).still.opacity_logits[5] == -9.0


def test_the_given_gaussians_of_a_span_are_learnt_in_the_light_that_they_are_shown_in():
    cloud, still = learning(), gaussians(9, 4)
    cloud.light = torch.tensor([0.5, 1.5])
    changed, others = torch.tensor([0, 5, 8]), torch.tensor([1, 2, 3, 4, 6, 7])
    for name in vars(still):
        getattr(still, name)[changed] = getattr(cloud.still, name)
        getattr(still, name)[others] = getattr(cloud.common, name)
    shown = SpannedScene(still, [SpanContent.of(SPANS[0], changed, cloud)], SPANS[0], cloud.light)
    for share, gain in ((0.25, 0.5), (0.75, 1.5)):
        instant_s = SPANS[0].first_s + share * (SPANS[0].last_s - SPANS[0].first_s)
        given = cloud.at(instant_s).intensities[: cloud.given]
        assert torch.equal(given, gain * cloud.common.intensities)
        a, b = (one.look(CAMERA, instant_s).intensity for one in (shown, cloud))
        assert torch.allclose(torch.from_numpy(a), torch.from_numpy(b), atol=1e-6)
