"""Tests of the shares of motion, of counting and of noise in the variance that SPSS sees."""

import numpy as np
import pytest

from reconstruction.bench.variance_shares import split, variance_shares
from rigs.toml import catalog_rig

WINDOWS, PIXELS = 5, 20_000


def fired(charges, rng):
    """Counts of pixels that gather `charges` [T, N] from a random phase."""
    ends = rng.random(charges.shape[1]) + np.cumsum(charges, axis=0)
    return np.diff(np.floor(ends), axis=0, prepend=0.0)


def test_steady_light_varies_by_counting_alone():
    charges = np.full((WINDOWS, PIXELS), 2.3)
    found = split(charges, fired(charges, np.random.default_rng(1)))
    assert found["motion"] == 0
    assert found["counting"] == pytest.approx(1, abs=0.02)
    assert found["noise"] == pytest.approx(0, abs=0.02)


def test_strong_changes_are_motion():
    rng = np.random.default_rng(2)
    charges = rng.uniform(0, 60, (WINDOWS, PIXELS))
    found = split(charges, fired(charges, rng))
    assert found["motion"] > 0.99
    assert found["spikes2"] == pytest.approx(float(np.diff(charges, axis=0).var(axis=0).mean()), rel=0.01)


def test_what_a_sensor_adds_is_noise():
    rng = np.random.default_rng(3)
    charges = np.full((WINDOWS, PIXELS), 4.0)
    found = split(charges, fired(charges, rng) + rng.normal(0, 1, charges.shape))
    assert found["noise"] == pytest.approx(1, abs=0.02)
    assert found["spikes2"] == pytest.approx(2 - 2 / 16, rel=0.02)  # of four differences that overlap


def test_nothing_that_varies_has_no_shares():
    still = np.full((WINDOWS, 3), 2.0)
    assert split(still, still) == {"spikes2": 0, "motion": 0, "counting": 0, "noise": 0}


def test_the_shares_of_a_scene_sum_to_one():
    found = variance_shares(catalog_rig("ci3x3").scaled(40, 25))
    for part in ("movers", "still"):
        assert sum(found[f"variance.{part}.{name}"] for name in ("motion", "counting", "noise")) == pytest.approx(1)
    assert found["variance.movers.motion"] > found["variance.still.motion"]
