"""Pictures of a lens that bends are straightened once, with counts, masks and noise, and renders are bent back."""

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
from reconstruction.images.catalogue import method
from reconstruction.images.composite import CompositeSource, GivenSource
from reconstruction.images.flicker import Light
from reconstruction.images.response import NEVER, Response
from reconstruction.images.straightened import straightened
from reconstruction.lenses.straight import straightening, view_of
from reconstruction.losses.counts import robust_loss
from reconstruction.methods.definition import SpikeSampling
from reconstruction.rendering.result import Rendering
from reconstruction.scene_model import TimeSpan
from reconstruction.training.changed_pixels import changed_pixels
from reconstruction.training.draws import Draws
from reconstruction.training.image_term import ImageTerm, alike_beyond
from reconstruction.training.spike_term import SpikeTerm, part_with_mover
from reconstruction.training.view import TrainingView
from rigs.camera import Camera
from rigs.clock import RigClock
from rigs.transform import Transform

W, H, PLANES, RATE_HZ = 60, 43, 64, 20_000.0
LENS = (-0.2, 0.01, 0.001, 0.0)
CAMERA = Camera("cam00", W, H, 52.0, 52.0, 31.0, 20.0, Transform.identity(), LENS)
STEADY, CLIP = Light.steady(PLANES), TimeSpan(0.0, PLANES / RATE_HZ)
MOVER = np.s_[10:20, 22:34]


@pytest.fixture(scope="module")
def sources():
    """A shaded wall with a square that appears halfway, two dead pixels; as recorded and straightened."""
    rows, columns = np.indices((H, W))
    light = np.repeat((0.2 + 0.3 * columns / W + 0.1 * np.sin(rows / 3))[None], PLANES, axis=0).astype(np.float32)
    light[PLANES // 2 :, *MOVER] = 0.8
    light[:, 30, 40] = light[:, 5, 5] = 0.0
    layout = PlaneLayout(W, H)
    stream = SpikeStream(pack(Sensor(W, H, "ideal", 1, 0).expose(light), layout), layout, RATE_HZ)
    moving = np.zeros((H, W), bool)
    moving[MOVER] = True
    recorded = CompositeSource(stream, background(stream, moving, STEADY), moving, method("tfp"), STEADY)
    way = straightening(CAMERA, view_of(CAMERA))
    return light, recorded, straightened(recorded, way), way


def test_given_images_keep_the_counts_and_masks_of_the_view(sources):
    _, recorded, _, way = sources
    source = straightened(replace(recorded, response=Response.even((H, W)).times(0.5), kept={}), way)
    image = np.full(source.moving.shape, 0.25, np.float32)
    given = GivenSource.of(source, {7: image}, planes=3)
    assert given.exposed(7, 3) == (6, 3)
    assert given.at(7) is image
    np.testing.assert_array_equal(given.counts(0, 20, np.s_[5:9, 3:20]), source.counts(0, 20, np.s_[5:9, 3:20]))
    np.testing.assert_array_equal(given.useless(20), source.useless(20))
    fewer = source.moving & (np.arange(source.moving.shape[1]) < 30)
    assert (given.recorded_mask(fewer) == source.recorded_mask(fewer)).all()
    assert given.recorded_mask(fewer).shape == (H, W)
    again = given.retargeted(fewer, lambda stream, moving: method("tfp"))
    assert (again.moving == fewer).all()
    assert (again.spikes.moving == fewer).all()
    assert (again.at(7) == image).all()


def test_images_counts_and_masks_are_those_of_the_view(sources):
    light, recorded, source, way = sources
    inside = way.covered & ~source.background.stuck
    source.at(20)
    assert list(source.kept) == [20]
    assert not recorded.kept  # what is kept is kept once
    whole = np.zeros((H, W), bool)
    whole[5:25, 17:39] = True
    inside &= source.moving | ~way.touched(whole)  # still pixels know nothing of movers a few pixels off
    for plane in (3, 50):
        np.testing.assert_allclose(source.at(plane)[inside], way.light(recorded.at(plane))[inside], atol=2e-5)
    counts = source.stream.counts(0, 20)
    wanted = way.light(20 * light[0])
    assert np.abs(counts - wanted)[inside & ~way.touched(light[0] == 0)].max() < 1.5  # each within a spike
    np.testing.assert_array_equal(source.counts(0, 20, np.s_[5:9, 3:20]), counts[5:9, 3:20])
    assert (source.moving == way.touched(recorded.moving) & way.covered).all()
    assert source.moving.sum() > 120
    assert source.background.stuck[~way.covered].all()
    assert not source.background.trusted[~way.covered].any()
    assert source.background.stuck[way.touched(light[0] == 0)].all()


def test_what_is_not_covered_goes_on_as_what_is_next_to_it(sources):
    _, _, source, way = sources
    image = source.background.image
    assert not way.covered.all()
    assert np.isfinite(image).all()
    assert set(image[~way.covered]) <= set(image[way.covered])


def test_a_source_may_be_given_other_moving_pixels(sources):
    _, recorded, source, way = sources
    moving = np.zeros(way.covered.shape, bool)
    moving[20:30, 20:30] = True
    found = source.retargeted(moving, lambda stream, mask: replace(method("tfp"), name=f"{mask.sum()}"))
    assert found.moving is moving
    assert found.recorded.moving.shape == (H, W)
    assert (way.touched(found.recorded.moving) & moving).sum() == 100
    assert found.recorded.method.name == str(found.recorded.moving.sum())
    assert source.recorded_mask(moving).shape == recorded.recorded_mask(recorded.moving).shape


def test_images_are_compared_where_they_were_seen(sources):
    _, _, source, way = sources
    rng = np.random.default_rng(0)
    target = torch.from_numpy(source.at(3)).double()
    image = (target + torch.from_numpy(rng.normal(0, 0.02, target.shape))).clamp_min(0).requires_grad_()
    alpha = torch.full(target.shape, 0.9, dtype=torch.float64)
    view = TrainingView(view_of(CAMERA), source)
    term = ImageTerm(RigClock(RATE_HZ), 0.6, ssim=0.0)
    seen = alike_beyond(torch.from_numpy(way.covered), Rendering(image[..., None], alpha, alpha, alpha), target)
    loss = term.held(view, *seen)
    off = (image - target).abs().detach().numpy()[way.covered].mean() / 0.6
    assert loss.item() == pytest.approx(off + 0.02 * 0.1)
    loss.backward()
    assert image.grad is not None
    assert not image.grad[~torch.from_numpy(way.covered)].any()
    same = ImageTerm(RigClock(RATE_HZ), 0.6).held(view, seen[0], seen[0].intensity[..., 0].detach())
    assert same.item() == pytest.approx(0.02 * 0.1)


def test_counts_are_compared_by_the_noise_they_have(sources):
    source = sources[2]
    view, seen = TrainingView(view_of(CAMERA), source), []

    def loss(light, rate, planes, noise):
        seen.append((rate, noise))
        return robust_loss(light, rate, planes, noise)

    still = GaussianCloud.from_points(torch.tensor([[0.0, 0, 2]]), torch.full((1, 1), 0.5), torch.zeros(1), 0.9)
    none = still.select(torch.zeros(0, dtype=torch.long))
    cloud = DynamicCloud(still, none, PolynomialMotion.at_rest(torch.zeros(0), 1.0), CLIP)
    term = SpikeTerm(ImageTerm(RigClock(RATE_HZ), 0.6), loss, SpikeSampling(size_px=(24, 16)))
    assert torch.isfinite(term(cloud, view, Draws(1, 0)))
    (rate, noise), part = seen[0], part_with_mover(view, (24, 16), Draws(1, 0).rng)
    assert rate.shape == noise.shape == (int((~source.useless(20)[part.within]).sum()),)
    assert 0.45 < noise.min() < noise.max() <= 1.01
    recorded = TrainingView(CAMERA.pinhole(), source.recorded)
    assert part_with_mover(recorded, (24, 16), np.random.default_rng(0)).noise(recorded) is None
    halved = robust_loss(torch.tensor(0.3), torch.tensor(0.5), 16, 0.5)
    assert halved > robust_loss(torch.tensor(0.3), torch.tensor(0.5), 16)


def test_a_steady_wall_does_not_change_when_it_is_straightened(sources):
    _, recorded, _, way = sources
    rng = np.random.default_rng(0)
    light = np.repeat(rng.uniform(0.1, 0.6, (1, H, W)), 256, axis=0).astype(np.float32)
    stream = SpikeStream(pack(Sensor(W, H, "real", 1, 0).expose(light), PlaneLayout(W, H)), PlaneLayout(W, H), RATE_HZ)
    still, steady = np.ones((H, W), bool), Light.steady(256)
    wall = replace(recorded, stream=stream, background=background(stream, ~still, steady), moving=~still, light=steady)
    straight = straightened(wall, way)
    looked = ~straight.background.stuck
    assert not changed_pixels(straight.stream, looked, steady, way).any()


def test_renders_are_seen_through_the_lens():
    rng = np.random.default_rng(1)
    means = torch.tensor(np.stack([rng.uniform(-2, 2, 600), rng.uniform(-1.5, 1.5, 600), rng.uniform(2, 3, 600)], 1))
    still = GaussianCloud.from_points(
        means.float(), torch.tensor(rng.uniform(0.1, 0.6, (600, 1))).float(), torch.full((600,), 0.16).log(), 0.9
    )
    none = still.select(torch.zeros(0, dtype=torch.long))
    cloud = DynamicCloud(still, none, PolynomialMotion.at_rest(torch.zeros(0), 1.0), CLIP)
    found = cloud.look(CAMERA, 0.001)
    assert found.intensity.shape == found.depth.shape == (H, W)
    large = CAMERA.pinhole().scaled(4 * W, 4 * H)
    large = replace(large, width=6 * W, height=6 * H, cx=large.cx + W, cy=large.cy + H)  # a quarter of a pixel each
    fine, places = (
        cloud.look(large, 0.001),
        CAMERA.slopes(np.stack(np.meshgrid(np.arange(W), np.arange(H)), -1).reshape(-1, 2) + 0.5),
    )
    column, row = np.floor(places * (large.fx, large.fy) + (large.cx, large.cy)).astype(int).T
    gap = found.intensity.ravel() - fine.intensity[row, column]
    assert np.sqrt((gap**2).mean()) < 0.005
    straight = cloud.look(CAMERA.pinhole(), 0.001).intensity.ravel()
    assert ((straight - fine.intensity[row, column]) ** 2).mean() > 9 * (gap**2).mean()
    known = np.isfinite(found.depth.ravel()) & np.isfinite(fine.depth[row, column])
    assert np.median(np.abs(found.depth.ravel() / fine.depth[row, column] - 1)[known]) < 0.01


def test_maps_of_pixels_are_applied_before_pictures_are_straightened():
    """Pixels that differ by a third show light known in closed form: means over them, evened out later, would not."""
    rng, planes = np.random.default_rng(4), 400
    pinhole = view_of(CAMERA)

    def light_at(camera, places):
        x, y = 52 * camera.slopes(places).T
        return 0.3 + 0.1 * np.sin(x / 5) * np.cos(y / 4)

    def middles(camera):
        rows, columns = np.indices((camera.height, camera.width)) + 0.5
        return np.stack([columns.ravel(), rows.ravel()], axis=1)

    true = light_at(CAMERA, middles(CAMERA)).reshape(H, W)
    gain = np.clip(1 + 0.3 * rng.standard_normal((H, W)), 0.3, 2).astype(np.float32)
    offset = rng.uniform(0, 0.05, (H, W)).astype(np.float32)
    fails = np.where(rng.random((H, W)) < 0.02, 0, NEVER).astype(np.int32)
    fails[0, 0] = fails[0, -1] = fails[-1, 10] = 0  # at the border as well
    rate = np.where(fails == 0, 1.0, true * gain + offset)
    spikes = np.diff(np.floor(np.arange(planes + 1)[:, None, None] * rate + rng.random((H, W))), axis=0)
    layout = PlaneLayout(W, H)
    stream = SpikeStream(pack(spikes.astype(np.uint8), layout), layout, RATE_HZ)
    light, response, moving = Light.steady(planes), Response(gain, offset, fails), np.zeros((H, W), bool)
    moving[MOVER] = True
    still = background(stream, np.zeros((H, W), bool), light, response)
    way = straightening(CAMERA, pinhole)
    source = straightened(CompositeSource(stream, still, moving, method("tfp"), light, response=response), way)
    wanted = light_at(pinhole, middles(pinhole)).reshape(way.covered.shape)
    good = way.covered & ~source.useless(planes)
    assert good.mean() > 0.6
    assert way.touched(fails == 0)[good].sum() == 0
    for found in (source.background.image, source.counts(0, planes) / planes):
        assert (
            np.abs(found - wanted)[good].max() < 0.012
        )  # .006: a spike in 400 planes over the least gain, and resampling
        assert np.sqrt(np.mean((found - wanted)[good] ** 2)) < 0.002  # .0012
    later = way.light(stream.counts(0, planes) / planes - offset) / way.light(gain)
    assert np.sqrt(np.mean((later - wanted)[good] ** 2)) > 0.02  # .027
    assert np.abs(source.at(200) - wanted)[good & source.moving].mean() < 0.02  # .011, of few planes
