"""Tells how fast this machine is now: other guests may halve its speed without taking a tick of its time."""

import time
from functools import cache

from reconstruction.bench.rasterizer import Step, random_cloud
from rigs.toml import catalog_rig

GAUSSIANS, STEPS = 20_000, 30


def step_ms() -> float:
    """Return the milliseconds that a training step of fixed work takes now, a mean over STEPS."""
    step = _step()
    step.whole()
    began = time.perf_counter()
    for _ in range(STEPS):
        step.whole()
    return 1000 * (time.perf_counter() - began) / STEPS


@cache
def _step() -> Step:
    camera = catalog_rig("lab3x3").camera("cam11")
    return Step(random_cloud(GAUSSIANS, camera), camera)
