"""Pixels of a long recording that are crossed once, put down, taken away, or never still."""

import numpy as np
import pytest

from reconstruction.images.background import Background
from reconstruction.images.standing import standing, unlike_share

SHAPE = (20, 30)
SPANS = 6
PLANES = [400] * SPANS


def usual(value: float = 0.05) -> Background:
    return Background(np.full(SHAPE, value, np.float32), np.zeros(SHAPE, dtype=bool), np.zeros(SHAPE, dtype=bool))


def quiet_scene() -> tuple[np.ndarray, np.ndarray]:
    rates = np.full((SPANS, *SHAPE), 0.2, np.float32)
    rates += 0.001 * np.random.default_rng(0).standard_normal(rates.shape).astype(np.float32)
    return rates, np.zeros((SPANS, *SHAPE), dtype=bool)


def test_a_pixel_that_is_crossed_once_has_the_background_of_the_other_spans():
    rates, moving = quiet_scene()
    rates[2, 5:9, 5:9], moving[2, 5:9, 5:9] = 0.5, True
    found = standing(rates, moving, usual(), PLANES)
    assert np.abs(found.background.image - 0.2).max() < 0.004
    assert found.background.trusted.all()
    assert not found.differs.any()


def test_what_is_put_down_differs_from_then_on():
    rates, moving = quiet_scene()
    moving[4, 5:9, 5:9] = True
    rates[5, 5:9, 5:9] = 0.4
    found = standing(rates, moving, usual(), PLANES)
    assert np.abs(found.background.image - 0.2).max() < 0.004
    assert found.differs[5, 5:9, 5:9].all()
    assert not found.differs[:5].any()
    assert not found.differs[5, 14:].any()


def test_the_background_is_what_most_spans_show():
    rates, moving = quiet_scene()
    rates[:4, 5:9, 5:9] = 0.4
    found = standing(rates, moving, usual(), PLANES)
    assert np.allclose(found.background.image[6, 6], 0.4, atol=0.004)
    assert found.differs[4:, 6, 6].all()
    assert not found.differs[:4, 6, 6].any()


def seen_by_turns() -> tuple[np.ndarray, np.ndarray]:
    """Return a board, bright in three spans and dark in two; each column is still in all of them but one, or in all."""
    rates, moving = quiet_scene()
    rates[:3, 5:15, 6:15] = 0.4
    moving[5, 5:15, 6:15] = True
    moving[2, 5:15, 6:15:3] = True
    moving[0, 5:15, 7:15:3] = True
    return rates, moving


def test_pixels_that_are_like_the_background_in_no_span_differ_wherever_they_are_still():
    rates, moving = seen_by_turns()
    found = standing(rates, moving, usual(0.05), PLANES)
    inside = np.s_[6:14, 7:14]
    assert (found.differs == ~moving)[:, *inside].all()
    expected = [0.2, 0.4, 0.2, 0.2, 0.4, 0.2, 0.2]  # the median of the spans in which a column is still
    assert np.allclose(found.background.image[inside], expected, atol=0.004)
    assert not found.background.trusted[inside].any()


def test_a_pixel_that_is_never_still_is_as_the_usual_background_says_and_not_sure():
    rates, moving = quiet_scene()
    moving[:, 5:9, 5:9] = True
    found = standing(rates, moving, usual(0.05), PLANES)
    assert (found.background.image[5:9, 5:9] == np.float32(0.05)).all()
    assert not found.background.trusted[5:9, 5:9].any()
    assert found.background.trusted[12:].all()
    assert not (found.differs & moving).any()


def test_nothing_still_at_all_is_the_usual_background():
    rates, moving = quiet_scene()
    found = standing(rates, ~moving, usual(0.1), PLANES)
    assert (found.background.image == np.float32(0.1)).all()
    assert not found.differs.any()


def test_one_span_and_no_light_are_finite():
    found = standing(np.zeros((1, *SHAPE), np.float32), np.zeros((1, *SHAPE), dtype=bool), usual(0.0), [1])
    assert np.isfinite(found.background.image).all()
    assert not found.differs.any()


@pytest.mark.parametrize(("step", "share"), [(0.0, 0.0), (0.004, 0.0), (0.05, 1.0), (-0.05, 1.0)])
def test_two_pictures_differ_where_the_step_between_them_shows(step, share):
    rates = np.full((12, 16), 0.3, np.float32)
    assert unlike_share(rates, rates + np.float32(step), 400) == share
    assert unlike_share(rates + np.float32(step), rates, 400) == share


def test_a_noisy_pixel_alone_is_no_difference():
    rates = np.full((12, 16), 0.3, np.float32)
    noisy = rates.copy()
    noisy[5, 5] += 0.05
    assert unlike_share(rates, noisy, 400) == 0.0


def test_the_last_spike_of_a_dim_span_is_no_difference():
    planes, light = 333, 0.004  # a spike or two a span
    phases = np.random.default_rng(1).random((SPANS, *SHAPE))
    rates = (np.floor(light * planes + phases) / planes).astype(np.float32)
    still = np.zeros((SPANS, *SHAPE), dtype=bool)
    found = standing(rates, still, usual(light), [planes] * SPANS)
    assert found.differs.mean() < 0.001
    assert found.background.trusted.all()
    assert unlike_share(rates[0], rates[1], planes) < 0.001
    bright = rates.copy()
    bright[4, 5:12, 5:12] += 0.01
    assert standing(bright, still, usual(light), [planes] * SPANS).differs[4, 6:11, 6:11].all()
