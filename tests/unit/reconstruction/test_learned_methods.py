import json

import cv2
import numpy as np
import pytest
import torch

from acquisition.errors import BadRecordingError
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.catalogue import method
from reconstruction.images.learned import learned
from reconstruction.networks import image_networks
from reconstruction.networks.image_networks import SHIPPED, gathered, image_network, infer
from reconstruction.tensors import write_weights

SHIPPED_NAMES = ["small", "blindspot"]
LEARNED = ["spk2imgnet", "blindspot"]


def stream_of(planes):
    layout = PlaneLayout(planes.shape[2], planes.shape[1])
    return SpikeStream(pack(planes, layout), layout, 20000.0)


def fired(light, rng):
    """Integrate-and-fire planes of `light` [T, H, W]."""
    total = np.cumsum(light, axis=0) + rng.random(light.shape[1:])
    return np.diff(np.floor(total), axis=0, prepend=np.floor(total[:1] - light[:1])).astype(np.uint8)


def awake(name):
    torch.manual_seed(0)
    module = image_network(name).build().eval()
    for parameter in module.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    return module


@pytest.mark.parametrize("name", SHIPPED_NAMES)
def test_tiles_leave_no_seams(name, monkeypatch):
    spikes = np.random.default_rng(0).integers(0, 2, (140, 51, 44)).astype(np.uint8)
    whole = infer(image_network(name), awake(name), stream_of(spikes), 70)
    monkeypatch.setattr(image_networks, "TILE", 16)
    for a, b in zip(whole, infer(image_network(name), awake(name), stream_of(spikes), 70), strict=True):
        assert np.abs(a - b).max() < 1e-6


@pytest.mark.parametrize("name", LEARNED)
@pytest.mark.parametrize("size", [(1, 1), (5, 9), (16, 17), (33, 2)])
@pytest.mark.parametrize(("planes", "plane"), [(1, 0), (7, 6), (200, 0)])
def test_any_size_and_any_instant_give_a_finite_image(name, size, planes, plane):
    spikes = np.random.default_rng(1).integers(0, 2, (planes, *size)).astype(np.uint8)
    found = method(name)(stream_of(spikes), plane)
    assert found.intensity.shape == found.valid.shape == size
    assert found.intensity.dtype == np.float32
    assert np.isfinite(found.intensity).all()
    assert (found.intensity >= 0).all()


@pytest.mark.parametrize("name", LEARNED)
@pytest.mark.parametrize("plane", [-1, 10])
def test_an_instant_outside_the_stream_is_refused(name, plane):
    with pytest.raises(BadRecordingError, match="expected one inside 0:10"):
        method(name)(stream_of(np.ones((10, 4, 4), np.uint8)), plane)


@pytest.mark.parametrize("name", LEARNED)
def test_darkness_is_dark_and_not_valid_and_full_light_is_one_spike_a_tick(name):
    dark = method(name)(stream_of(np.zeros((150, 9, 8), np.uint8)), 75)
    full = method(name)(stream_of(np.ones((150, 9, 8), np.uint8)), 75)
    assert dark.intensity.max() < 2e-3
    assert not dark.valid.any()
    assert np.abs(full.intensity - 1).max() < 0.1
    assert full.valid.all()


@pytest.mark.parametrize("name", LEARNED)
@pytest.mark.parametrize("light", [0.01, 0.05, 0.3, 0.6, 0.95])
def test_even_light_comes_back_at_every_level(name, light):
    spikes = fired(np.full((600, 32, 32), light), np.random.default_rng(2))
    found = method(name)(stream_of(spikes), 300).intensity
    assert found.mean() == pytest.approx(light, rel=0.03)
    assert found.std() / light < 0.05


def test_dim_planes_are_joined_in_groups_about_the_instant_and_the_light_is_divided_again():
    spikes = fired(np.full((400, 8, 8), 0.011), np.random.default_rng(5))
    joined, middle, group = gathered(stream_of(spikes), 200, 64)
    assert group == 3
    assert len(joined) == 2 * 64 + 1
    assert np.array_equal(joined.planes(middle, middle + 1)[0], spikes[199:202].any(axis=0))
    assert joined.counts(0, len(joined)).sum() == spikes[200 - 193 : 200 + 194].sum()


@pytest.mark.parametrize(("light", "planes", "plane"), [(0.2, 200, 100), (0.01, 200, 0), (0.001, 5, 2)])
def test_planes_are_not_joined_where_light_is_enough_or_no_group_has_room(light, planes, plane):
    stream = stream_of(fired(np.full((planes, 8, 8), light), np.random.default_rng(5)))
    assert gathered(stream, plane, 64) == (stream, plane, 1)


@pytest.mark.parametrize("name", LEARNED)
def test_a_moving_edge_is_sharper_than_any_window_and_quieter_than_an_interval(name):
    """A field of squares, as sharp as a lens leaves them, that moves a tenth of a pixel a tick."""
    rng = np.random.default_rng(3)
    texture = cv2.GaussianBlur(np.kron(rng.uniform(0.05, 0.6, (12, 24)), np.ones((5, 5))), (0, 0), 0.8)
    place = np.arange(60)[None, :] + 0.1 * np.arange(160)[:, None] % 60
    left = place.astype(int)
    mix = place - left
    light = texture[:, left % 120] * (1 - mix) + texture[:, (left + 1) % 120] * mix
    light = light.transpose(1, 0, 2)
    stream = stream_of(fired(light, rng))
    error = {n: np.sqrt(np.mean((method(n)(stream, 80).intensity - light[80]) ** 2)) for n in ("tfi", "tfp", name)}
    gain_db = {n: 20 * np.log10(error[n] / error[name]) for n in ("tfi", "tfp")}
    assert gain_db["tfi"] > 10  # the worst measured: 13.3
    assert gain_db["tfp"] > 4  # 5.3


def test_a_network_without_weights_is_refused_and_ones_own_weights_serve_it(tmp_path):
    stream = stream_of(np.random.default_rng(4).integers(0, 2, (50, 8, 8)).astype(np.uint8))
    with pytest.raises(BadRunError, match="found no weights"):
        learned("published", stream, 25)
    write_weights(tmp_path / "own.npz", awake("published").state_dict())
    assert np.isfinite(learned("published", stream, 25, tmp_path / "own.npz").intensity).all()


@pytest.mark.parametrize("name", SHIPPED_NAMES)
def test_shipped_weights_are_small_and_carry_their_training(name):
    assert (SHIPPED / f"{name}.npz").stat().st_size < 10e6
    document = json.loads((SHIPPED / f"{name}.json").read_text())
    assert document["network"] == name
    assert document["parameters"] == sum(p.numel() for p in image_network(name).build().parameters())
    assert document["pictures"]["clips"]["count"] > 0
    assert document["curve"][-1]["moving_db"] > document["curve"][0]["moving_db"] - 0.5
    assert document["curve"][-1]["development_db"] > 33  # 6 dB above TFI, which has 27.0
