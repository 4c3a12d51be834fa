"""Steps of the error of movers at seams are told from those within spans."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from reconstruction.bench.long.seams import steps_of_error
from reconstruction.scene_model import View
from rigs.clock import RigClock

CLOCK = RigClock(20_000.0)
SHAPE = (4, 6)
MOVING = np.zeros(SHAPE, bool)
MOVING[1:3, 2:4] = True


class Scene:
    """A scene in spans of 20 planes that is off by `errors[span]` spikes per tick, and by more the later it is."""

    def __init__(self, errors, slope=0.0):
        self.errors, self.slope = errors, slope

    def number_at(self, instant_s):
        return min(CLOCK.plane(instant_s) // 20, len(self.errors) - 1)

    def look(self, camera, instant_s):
        off = self.errors[self.number_at(instant_s)] + self.slope * CLOCK.plane(instant_s)
        return View(np.full(SHAPE, 0.3 + off, np.float32), np.ones(SHAPE, np.float32))


def steps(scene: Scene, planes, moving=MOVING) -> tuple[list[float], list[float]]:
    """The steps of the scene's error at `planes`, whose truth is .3 everywhere."""
    frame = SimpleNamespace(intensity=np.full(SHAPE, 0.3, np.float32), moving=moving)
    truth: Any = SimpleNamespace(planes=lambda _: planes, frame=lambda *_: frame, lag_ticks=0.0)
    recording = SimpleNamespace(rig=SimpleNamespace(clock=CLOCK))
    held_out: Any = SimpleNamespace(camera=SimpleNamespace(id="cam11"), recording=recording)
    shown: Any = scene
    return steps_of_error(shown, held_out, truth)


def test_steps_at_seams_are_told_from_those_within_spans():
    at_seams, within = steps(Scene([0.0, 0.1, -0.1], slope=0.001), range(0, 60, 10))
    assert at_seams == pytest.approx([0.11, 0.19], abs=1e-6)
    assert within == pytest.approx([0.01] * 3, abs=1e-6)


@pytest.mark.parametrize("planes", [[], [7], [0, 40]])
def test_few_instants_make_few_steps(planes):
    at_seams, within = steps(Scene([0.0, 0.1, 0.2]), planes)
    assert within == []
    assert len(at_seams) == max(0, len(planes) - 1)


def test_pixels_that_never_move_do_not_count():
    assert steps(Scene([0.0, 0.5]), [0, 30], np.zeros(SHAPE, bool)) == ([], [])
