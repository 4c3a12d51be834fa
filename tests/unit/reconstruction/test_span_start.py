"""The start of the training of a span."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.points import Points
from reconstruction.pipeline import span_training
from reconstruction.run.spans import Span
from rigs.clock import RigClock
from rigs.toml import catalog_rig

CAMERA = catalog_rig("ci3x3").camera("cam11")
SWEEPS = 4


def points(count: int) -> Points:
    positions = np.random.default_rng(count).uniform((-0.2, -0.2, 1.8), (0.2, 0.2, 2.2), (count, 3))
    return Points(positions, np.full(count, 0.5, np.float32), np.full(count, 0.02), np.linspace(0.0, 0.02, count))


def free(count: int) -> Bodies:
    """Return no bodies, among so many points."""
    owners, reasons = np.full(count, -1), np.full(count, "alone")
    return Bodies(
        owners,
        np.zeros((0, SWEEPS, 4)),
        np.zeros((0, SWEEPS, 3)),
        np.linspace(0, 0.02, SWEEPS),
        np.zeros((0, 2)),
        reasons,
    )


@pytest.mark.parametrize("standing", [0, 7, 400])
def test_bodies_are_judged_without_what_stands_there(monkeypatch, standing):
    """The points of movers at rest are what bodies must be better than: none of them lives all the time."""
    moving, judged = points(20), []

    def judge(seeds, views, clock, still):
        judged.append((len(seeds.moving), seeds.resting))

    def choose(found, instants, judge_of, ways):
        judge_of(free(len(found)))
        return SimpleNamespace(bodies=free(len(found)))

    monkeypatch.setattr(span_training, "_moving", lambda *_: moving)
    monkeypatch.setattr(span_training, "_resting", lambda *_: points(standing))
    monkeypatch.setattr(span_training, "judge", judge)
    monkeypatch.setattr(span_training, "choose_bodies", choose)
    monkeypatch.setattr(span_training, "unsettled", lambda means, *_: torch.zeros(len(means), dtype=torch.bool))
    plan = SimpleNamespace(model="bases", sweeps=SWEEPS, spans=[Span(0, 400), Span(400, 800)])
    run: Any = SimpleNamespace(plan=plan, config=SimpleNamespace(seed=0, budget_s=None))
    recording: Any = SimpleNamespace(rig=SimpleNamespace(clock=RigClock(20_000.0), tick_rate_hz=20_000.0))
    seen: Any = [SimpleNamespace(camera=CAMERA, source=None, shown=None)]
    cloud, _ = span_training._started(
        run, recording, seen, GaussianCloud.from_points(torch.zeros(0, 3), torch.zeros(0, 1), torch.zeros(0), 0.5), 400
    )
    assert judged == [(20, 0)]
    assert len(cloud.moving) == 20 + standing
