import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.methods.tfi import tfi
from reconstruction.networks.blind_spot import GAP, OWN, blind_rates, reversed_blind_rates
from reconstruction.networks.rates import BINS, EDGES, REACH, charge, planes_around, rates


def stream_of(planes):
    layout = PlaneLayout(planes.shape[2], planes.shape[1])
    return SpikeStream(pack(planes, layout), layout, 20000.0)


def fired(light, planes, rng, size=(6, 7)):
    """Integrate-and-fire planes [planes, H, W] of constant light."""
    total = np.cumsum(np.full((planes, *size), light), axis=0) + rng.random(size)
    return np.diff(np.floor(total), axis=0, prepend=np.floor(total[:1] - light)).astype(np.uint8)


def charge_reference(planes, ticks):
    """The definition, pixel by pixel: straight lines between the spikes, the ends as `charge` says."""
    out = np.zeros((len(ticks), *planes.shape[1:]))
    total = len(planes)
    for row, column in np.ndindex(planes.shape[1:]):
        at = np.flatnonzero(planes[:, row, column])
        if len(at) == 0:
            continue
        rate = (len(at) - 1) / (at[-1] - at[0]) if len(at) > 1 else 1 / total
        lead, trail = min(rate, 1 / (at[0] + 1)), min(rate, 1 / (total - at[-1]))
        for k, tick in enumerate(ticks):
            if tick < at[0]:
                out[k, row, column] = 1 - lead * (at[0] - tick)
            elif tick >= at[-1]:
                out[k, row, column] = len(at) + trail * (tick - at[-1])
            else:
                out[k, row, column] = np.interp(tick, at, np.arange(1, len(at) + 1))
    return out


@given(st.integers(0, 2**32 - 1), st.integers(2, 90), st.floats(0, 1))
def test_charge_agrees_with_its_definition(seed, planes, share):
    rng = np.random.default_rng(seed)
    spikes = (rng.random((planes, 3, 5)) < share).astype(np.uint8)
    ticks = np.sort(rng.integers(0, planes, 4))
    assert np.abs(charge(spikes, ticks) - charge_reference(spikes, ticks)).max() < 1e-5 * planes


def test_no_spike_is_no_charge_and_a_full_pixel_gathers_one_a_tick():
    ticks = EDGES + REACH
    assert (charge(np.zeros((129, 2, 3), np.uint8), ticks) == 0).all()
    assert np.allclose(np.diff(charge(np.ones((129, 2, 3), np.uint8), ticks), axis=0)[:, 0, 0], np.diff(EDGES))


@pytest.mark.parametrize("light", [0.03, 0.2, 0.61, 0.95])
def test_rates_of_constant_light_are_it_in_every_bin_on_average(light):
    found = rates(stream_of(fired(light, 200, np.random.default_rng(3), (24, 24))), 100)
    assert found.shape == (BINS, 24, 24)
    assert np.abs(found.mean(axis=(1, 2)) / light - 1).max() < 0.04  # worst 0.022, at 0.03 spikes a tick


def test_the_middle_bin_is_the_interval_where_intervals_are_long():
    stream = stream_of(fired(0.05, 200, np.random.default_rng(4)))
    inside = np.abs(rates(stream, 100)[BINS // 2] - tfi(stream, 100).intensity) < 1e-6
    assert inside.mean() > 0.7  # the bin of four ticks lies inside the interval


@pytest.mark.parametrize(("planes", "plane"), [(1, 0), (2, 1), (9, 4), (129, 0), (129, 128), (300, 299)])
def test_beyond_its_ends_a_stream_is_mirrored(planes, plane):
    spikes = np.random.default_rng(0).integers(0, 2, (planes, 3, 5)).astype(np.uint8)
    found = planes_around(stream_of(spikes), plane, REACH)
    at = np.abs(np.arange(plane - REACH, plane + REACH + 1) + 0.5) - 0.5  # first end
    at = at % (2 * planes)
    expected = spikes[np.where(at < planes, at, 2 * planes - 1 - at).astype(int)]
    assert np.array_equal(found, expected)
    assert np.isfinite(rates(stream_of(spikes), plane)).all()


@pytest.mark.parametrize("observe", [rates, blind_rates])
def test_observations_of_a_stream_run_backwards_are_those_reversed(observe):
    spikes = np.random.default_rng(1).integers(0, 2, (2 * REACH + 1, 4, 6)).astype(np.uint8)
    forward, backward = observe(stream_of(spikes), REACH), observe(stream_of(spikes[::-1]), REACH)
    turned = reversed_blind_rates(forward) if observe is blind_rates else forward[::-1]
    assert np.abs(turned - backward).max() < 1e-4


def test_a_pixels_own_bins_do_not_know_the_planes_of_the_gap():
    rng = np.random.default_rng(2)
    spikes = rng.integers(0, 2, (2 * REACH + 1, 5, 5)).astype(np.uint8)
    other = spikes.copy()
    other[REACH - GAP + 1 : REACH + GAP] = rng.integers(0, 2, (2 * GAP - 1, 5, 5))
    a, b = blind_rates(stream_of(spikes), REACH), blind_rates(stream_of(other), REACH)
    assert a.shape == (BINS + OWN, 5, 5)
    assert np.array_equal(a[BINS:], b[BINS:])
    assert not np.array_equal(a[:BINS], b[:BINS])


def test_raw_planes_are_the_forty_one_around_the_instant():
    spikes = np.random.default_rng(5).integers(0, 2, (90, 3, 3)).astype(np.uint8)
    assert np.array_equal(planes_around(stream_of(spikes), 50, 20), spikes[30:71])
