import numpy as np
import pytest
import torch
from torch.nn import functional

from reconstruction.errors import BadRunError
from reconstruction.networks.blind_spot import BlindSpotNet, joined
from reconstruction.networks.image_networks import IMAGE_NETWORKS, image_network, loss
from reconstruction.networks.rates import BINS, EDGES
from reconstruction.networks.spk2imgnet_published import PublishedSpk2ImgNet, deformed
from reconstruction.networks.spk2imgnet_small import SmallSpk2ImgNet, window_means
from reconstruction.tensors import read_weights, write_weights

CHANNELS = {"small": BINS, "published": 41, "blindspot": BINS + 4}


@pytest.fixture(autouse=True)
def _one_thread():
    """Tiny tensors: two threads would but wait for one another."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def parameters(module):
    return sum(p.numel() for p in module.parameters())


def awake(module):
    """The module with no weight at zero: as built, last layers are, and hide what lies before them."""
    torch.manual_seed(1)
    for parameter in module.parameters():
        if not parameter.detach().any():
            torch.nn.init.normal_(parameter, std=0.05)
    return module


def test_the_published_network_has_the_published_size_and_the_small_one_a_twentieth():
    assert abs(parameters(PublishedSpk2ImgNet()) / 3.90e6 - 1) < 0.005
    assert parameters(SmallSpk2ImgNet()) < 0.22e6
    assert parameters(BlindSpotNet()) < 0.22e6


@pytest.mark.parametrize("name", list(IMAGE_NETWORKS))
def test_every_weight_of_a_network_learns_from_a_small_batch(name):
    torch.manual_seed(0)
    seen, truth = torch.rand(1, CHANNELS[name], 8, 12), torch.rand(1, 1, 8, 12)
    module = awake(image_network(name).build())
    loss(image_network(name), module, seen, truth).backward()
    assert [n for n, p in module.named_parameters() if p.grad is None or not p.grad.abs().max() > 0] == []


@pytest.mark.parametrize("name", list(IMAGE_NETWORKS))
@pytest.mark.parametrize("light", [0.0, 1.0])
def test_darkness_and_saturation_give_finite_light_and_a_positive_error(name, light):
    seen = torch.full((1, CHANNELS[name], 8, 8), light)
    image, sigma = awake(image_network(name).build()).eval()(seen, image_network(name).level(seen))
    assert torch.isfinite(image).all()
    assert torch.isfinite(sigma).all()
    assert (sigma > 0).all()


@pytest.mark.parametrize("name", ["small", "published"])
def test_networks_that_need_truth_say_so(name):
    with pytest.raises(BadRunError, match="no true light"):
        loss(image_network(name), image_network(name).build(), torch.rand(1, CHANNELS[name], 8, 8), None)


def test_the_blind_spot_network_learns_without_truth_and_does_not_look_at_it():
    seen, module = torch.rand(1, CHANNELS["blindspot"], 8, 8), BlindSpotNet()
    without = loss(image_network("blindspot"), module, seen, None)
    assert without == loss(image_network("blindspot"), module, seen, torch.rand(1, 1, 8, 8))


def test_the_blind_spot_network_never_sees_the_interval_it_guesses():
    torch.manual_seed(0)
    module, seen = awake(BlindSpotNet()), torch.rand(1, BINS + 4, 21, 21, requires_grad=True)
    guess, spread = module.guess(seen, torch.full((1, 1, 1, 1), 0.4))
    (guess[0, 0, 10, 10] + spread[0, 0, 10, 10]).backward()
    slope = seen.grad.abs().amax(dim=1)[0]
    assert (seen.grad[0, :BINS, 10, 10] == 0).all()
    assert (seen.grad[0, BINS:, 10, 10] != 0).all()
    assert (slope[9:12, 9:12] > 0).all()


@pytest.mark.parametrize("light", [0.05, 0.27, 0.4, 0.7])
def test_a_guess_and_an_interval_are_joined_as_their_errors_tell(light):
    """A perfect guess keeps the light; a useless one leaves the interval, whose error is that of whole ticks."""
    ticks = np.floor(1 / light)
    noise = np.sqrt((1 / ticks - light) * (light - 1 / (ticks + 1)) + (0.01 * light) ** 2)
    guess, interval = torch.tensor([light]), torch.tensor([0.9])
    kept, _ = joined(guess, torch.tensor([float(noise) * 0.9]), interval)
    left, error = joined(guess, torch.tensor([1e3]), interval)
    assert kept.item() == pytest.approx(light)
    assert left.item() == pytest.approx(0.9, abs=1e-4)
    assert error.item() == pytest.approx(noise, rel=1e-3)


def test_window_means_are_means_of_ever_longer_windows():
    edges = torch.tensor(EDGES, dtype=torch.float32)
    rates = torch.rand(BINS)
    filters = window_means()[:, :, 0, 0]
    for k, row in enumerate(filters):
        half = edges[BINS // 2 + 1 + k]
        inside = (edges[:-1] >= -half) & (edges[1:] <= half)
        expected = (rates * edges.diff())[inside].sum() / (2 * half)
        assert (row @ rates).item() == pytest.approx(expected.item(), rel=1e-5)


def test_a_deformable_convolution_without_offsets_is_an_ordinary_one():
    torch.manual_seed(0)
    x, weight, bias = torch.randn(2, 8, 7, 9).double(), torch.randn(5, 8, 3, 3).double(), torch.randn(5).double()
    found = deformed(x, torch.zeros(2, 4 * 18, 7, 9).double(), weight, bias)
    assert (found - functional.conv2d(x, weight, bias, padding=1)).abs().max() < 1e-12


def test_a_deformable_convolution_with_the_same_offset_everywhere_is_a_shifted_one():
    torch.manual_seed(0)
    x, weight = torch.randn(1, 4, 8, 8).double(), torch.randn(3, 4, 3, 3).double()
    offsets = torch.zeros(1, 2 * 18, 8, 8).double()
    offsets[:, 0::2], offsets[:, 1::2] = 2, -1
    wide = functional.conv2d(functional.pad(x, (4, 4, 4, 4)), weight)
    assert (deformed(x, offsets, weight, None) - wide[:, :, 5:13, 2:10]).abs().max() < 1e-12


def test_gradients_of_the_deformable_convolution_are_right():
    torch.manual_seed(0)
    x = torch.randn(1, 2, 3, 2, dtype=torch.float64, requires_grad=True)
    offsets = (0.3 * torch.randn(1, 18, 3, 2, dtype=torch.float64)).requires_grad_()
    weight = torch.randn(2, 2, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda *a: deformed(*a, None), (x, offsets, weight))


def test_weights_in_half_precision_come_back_and_others_are_refused(tmp_path):
    module, other = SmallSpk2ImgNet(), SmallSpk2ImgNet()
    write_weights(tmp_path / "w.npz", module.state_dict())
    read_weights(tmp_path / "w.npz", other)
    for a, b in zip(module.parameters(), other.parameters(), strict=True):
        assert torch.equal(a.half().float(), b)
    with pytest.raises(BadRunError, match="other or damaged weights"):
        read_weights(tmp_path / "w.npz", BlindSpotNet())
    (tmp_path / "w.npz").write_bytes((tmp_path / "w.npz").read_bytes()[:999])
    with pytest.raises(BadRunError, match="other or damaged weights"):
        read_weights(tmp_path / "w.npz", other)
    with pytest.raises(BadRunError, match="no weights"):
        read_weights(tmp_path / "none.npz", other)


def test_weights_that_half_precision_cannot_hold_are_refused(tmp_path):
    with pytest.raises(BadRunError, match="not finite in half precision: a"):
        write_weights(tmp_path / "w.npz", {"a": torch.tensor([1e6])})
    assert not (tmp_path / "w.npz").exists()


def test_unknown_networks_are_refused_with_the_known_ones():
    with pytest.raises(BadRunError, match="small, published, blindspot"):
        image_network("crystal")
