"""Ending before the budget: when the loss stands still, with the rates run down first, and exactly after a kill."""

import numpy as np
import pytest

from reconstruction.training.ending import PATIENCE, RUN_DOWN, WINDOW, Ending


def fed(losses, views=4, seed=0):
    """An ending that saw these losses at random views, view k dimmer by k; one a step."""
    found, rng = Ending(views), np.random.default_rng(seed)
    for step, loss in enumerate(losses):
        view = int(rng.integers(views))
        found.see(view, loss * (1 + view), step + 1, step / 1e5)
    return found


def test_a_loss_that_falls_never_ends():
    assert fed(np.exp(-np.arange(20 * WINDOW) / (100 * WINDOW))).began is None


def test_a_loss_that_stands_still_ends_after_twice_the_patience():
    found = fed(np.ones(10 * WINDOW))
    assert found.began == 2 * PATIENCE * WINDOW
    assert "less than 0.2%" in found.reason(10 * WINDOW)


def test_views_that_come_up_more_often_do_not_pass_for_a_gain():
    found = Ending(2)
    for window in range(2 * PATIENCE):
        for step in range(WINDOW):  # ever more of the easy view, whose loss is the same all the time
            view = int(step % (window + 2) == 0)
            found.see(view, (1.0, 3.0)[view], window * WINDOW + step + 1, 0.0)
    assert found.windows == pytest.approx([2.0] * 2 * PATIENCE)
    assert found.began is not None


def test_the_rates_run_down_before_the_end():
    found = Ending(1, began=1000, share=0.4)
    assert found.done(0.4, 1000) == pytest.approx(0.4)
    assert found.done(0.41, 1000 + round(RUN_DOWN * 500)) == pytest.approx(0.7)
    assert found.done(0.45, 1000 + round(RUN_DOWN * 1000)) == 1.0
    assert found.done(0.95, 1010) == 0.95  # the budget runs out first


def test_enough_steps_end_a_loss_that_falls_on():
    found = Ending(1, enough=4000)
    assert found.done(0.1, 300) == 0.1  # the budget ends before them
    assert found.done(0.1, 1000) == 0.25
    assert found.done(0.3, 4000) == found.done(0.3, 4001) == 1.0
    assert found.reason(4000).startswith("4000 steps are enough")


def test_a_loss_that_stands_still_ends_before_enough_steps():
    found = Ending(1, enough=4000, windows=[1.0] * 2 * PATIENCE, began=3000, share=0.75)
    assert found.done(0.5, 3000) == 0.75
    assert found.done(0.5, 3000 + round(RUN_DOWN * 1500)) == pytest.approx(0.875)
    assert found.done(0.6, 3750) == 1.0
    assert "rates ran down from step 3000" in found.reason(3750)
    assert Ending(**found.state()) == found


def test_its_state_carries_it_on():
    losses = 1 + 0.1 * np.random.default_rng(1).random(8 * WINDOW)
    whole, first = fed(losses), Ending(4)
    rng = np.random.default_rng(0)
    for step, loss in enumerate(losses):
        if step == 3 * WINDOW + 17:
            first = Ending(**first.state())
        view = int(rng.integers(4))
        first.see(view, loss * (1 + view), step + 1, step / 1e5)
    assert first == whole
    assert whole.began is not None
