import numpy as np
import pytest
import torch

from acquisition.scenes.random.several_views import random_rig
from reconstruction.networks.msdi.depth import STEPS, likeliest
from reconstruction.networks.msdi.features import channels, evened, keypoints, patch_centers
from reconstruction.networks.msdi.inference import full_size
from reconstruction.networks.msdi.matching import FLOOR_PX, moments, window_cells
from reconstruction.networks.msdi.network import small_msdi
from reconstruction.networks.msdi.views import Views, inverse_depths
from reconstruction.networks.rates import BINS


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums in one order
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    return small_msdi().eval()


def prepared(network, rates, factor):
    """Light, sigma and the channels that the geometry sees."""
    light, sigma, level = network.light(rates)
    return light, sigma, channels(light, sigma, rates, level, factor)


def seen_by(rig, factor=1, seed=0):
    """Rates [V, BINS, h, w] of a smooth random picture."""
    rng = np.random.default_rng(seed)
    camera = rig.cameras[0]
    coarse = torch.from_numpy(rng.random((len(rig.cameras), 1, camera.height // 4 + 2, camera.width // 4 + 2)))
    size = (camera.height * factor, camera.width * factor)
    light = torch.nn.functional.interpolate(coarse, size=size, mode="bicubic").clamp(0.02, 1)
    return light.float().expand(-1, BINS, -1, -1).contiguous()


@pytest.mark.parametrize(("views", "width", "height"), [(3, 49, 33), (4, 64, 48), (9, 40, 32)])
@torch.no_grad()
def test_any_size_and_three_to_nine_views(network, views, width, height):
    rig = random_rig(1, views, width, height)
    rates = seen_by(rig)
    light, sigma, seen = prepared(network, rates, 1)
    assert light.shape == sigma.shape == (views, 1, height, width)
    assert seen.shape[2] % 8 == seen.shape[3] % 8 == 0
    solved = network.solve(seen, Views.of_rig(rig))
    tokens = seen.shape[2] * seen.shape[3] // 64
    assert solved.matches.found.shape == (views, tokens, views, 2)
    assert solved.adjusted.views.rotation.shape == (views, 3, 3)
    swept = network.sweep(solved.encoded.middle, solved.adjusted.views, views - 1)
    assert swept.inverse_depth.shape == swept.confidence.shape == seen.shape[2:]
    assert swept.logits.shape == (STEPS, seen.shape[2] // 4, seen.shape[3] // 4)
    assert (swept.confidence > 1).all()
    ends = inverse_depths(Views.of_rig(rig), STEPS)[[0, -1]]
    assert (swept.inverse_depth >= ends[0] - 1e-5).all()
    assert (swept.inverse_depth <= ends[1] + 1e-5).all()


@torch.no_grad()
def test_views_in_another_order_give_the_same_in_that_order(network):
    rig, order = random_rig(2, 4, 64, 48), [2, 0, 3, 1]
    seen = prepared(network, seen_by(rig), 1)[2]
    nominal = Views.of_rig(rig)
    one = network.solve(seen, nominal)
    two = network.solve(seen[order], nominal.select(order))
    assert torch.allclose(one.encoded.tokens[order], two.encoded.tokens, atol=1e-4)
    assert torch.allclose(one.matches.found[order][:, :, order], two.matches.found, atol=1e-2)
    assert torch.allclose(one.adjusted.views.center[order], two.adjusted.views.center, atol=1e-5)
    depth = [
        network.sweep(s.encoded.middle, nominal.select(o), v).inverse_depth
        for s, o, v in ((one, [0, 1, 2, 3], 2), (two, order, 0))
    ]
    assert torch.allclose(depth[0], depth[1], atol=1e-2, rtol=1e-2)


@pytest.mark.parametrize("light", [0.0, 1.0, 1e-6])
def test_gradients_are_finite_on_dark_and_saturated_views(network, light):
    rig = random_rig(3, 3, 48, 32)
    rates = seen_by(rig)
    rates[1] = light
    network.zero_grad()
    image, _, seen = prepared(network, rates, 1)
    solved = network.solve(seen, Views.of_rig(rig))
    swept = network.sweep(solved.encoded.middle, Views.of_rig(rig), 1)
    total = image.sum() + solved.matches.found[..., 0].mean() + solved.adjusted.views.rotation.sum()
    (total + swept.inverse_depth.mean() + swept.confidence.mean()).backward()
    for parameter in network.parameters():
        assert parameter.grad is None or torch.isfinite(parameter.grad).all()
    network.zero_grad()


def test_channels_do_not_know_how_bright_the_scene_is():
    rates = seen_by(random_rig(1, 3, 48, 32))
    level = rates.mean(dim=(1, 2, 3), keepdim=True)
    light = rates[:, :1]
    one = channels(light, 0.01 * light, rates, level, 1)
    dim = channels(0.1 * light, 0.001 * light, 0.1 * rates, 0.1 * level, 1)
    assert torch.allclose(one, dim, atol=1e-4)


def test_what_is_even_has_neither_mean_nor_contrast():
    rng = torch.Generator().manual_seed(0)
    image = 3 + 0.5 * torch.rand(1, 1, 60, 60, generator=rng)
    found = evened(image)
    assert abs(float(found.mean())) < 0.02
    assert float(found.std()) == pytest.approx(1, abs=0.15)
    assert torch.equal(evened(torch.ones(1, 1, 20, 20)), torch.zeros(1, 1, 20, 20))


def test_keypoints_lie_in_their_patches_and_on_corners():
    seen = torch.zeros(1, 5, 32, 48)
    seen[:, :, 12:, 20:] = 1  # the corner of a bright square, in the patch of row 1 and column 2
    found = keypoints(seen)[0]
    centers = patch_centers((48, 32))
    assert (found - centers).abs().max() <= 4
    assert torch.allclose(found[1 * 6 + 2], torch.tensor([20.0, 12.0]), atol=2)


def test_windows_lie_about_the_middle_of_their_token():
    x, y = window_cells(torch.tensor([[7]]), 24)  # six tokens a row: row 1, column 1
    assert x.shape == (1, 1, 81)
    assert float(x.float().mean()) == float(y.float().mean()) == 6


def test_moments_are_those_of_the_softmax():
    centers = torch.tensor([[0.0, 0.0], [2.0, 0.0]])
    mean, covariance = moments(torch.tensor([0.0, 0.0]), centers)
    assert torch.allclose(mean, torch.tensor([1.0, 0.0]))
    assert torch.allclose(covariance, torch.diag(torch.tensor([1 + FLOOR_PX**2, FLOOR_PX**2])))


def test_the_likeliest_depth_is_not_drawn_aside_by_a_second_peak():
    steps = torch.linspace(0.2, 2.0, 10)
    logits = torch.full((10, 1, 1), -20.0)
    logits[3], logits[9] = 5.0, 4.0
    found, share = likeliest(logits, steps)
    assert float(found) == pytest.approx(float(steps[3]), abs=1e-4)
    assert float(share) == pytest.approx(float(torch.sigmoid(torch.tensor(1.0))), abs=1e-3)


def test_small_maps_and_views_keep_their_places_at_full_size():
    columns = np.mgrid[0:6, 0:8][1] + 0.5
    large = full_size((columns * 2).astype(np.float32), 2, 11, 15)
    assert large.shape == (11, 15)
    assert np.allclose(large[5, 3:12], np.arange(3, 12) + 0.5, atol=1e-5)
    rig = random_rig(1, 3, 64, 48)
    halves = [(camera.cx / 2, camera.cy / 2) for camera in rig.cameras]
    assert torch.allclose(Views.of_rig(rig, 2).principal, torch.tensor(halves, dtype=torch.float64))
