"""Far and empty backgrounds through the stages: what is decided, and where points are put."""

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.session.record import simulate
from reconstruction.initialization.points import Points
from reconstruction.pipeline.artefacts import EMPTY, STILL, read
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3").scaled(100, 62)
CONFIG = ReconstructionConfig(holdout="cam11", gaussians=3000, budget_s=None, steps=1)


@pytest.fixture(scope="module")
def pointed(tmp_path_factory):
    """Return the run of a scene up to its points, made once."""
    made = {}

    def run_of(scene):
        if scene not in made:
            folder = tmp_path_factory.mktemp(scene)
            simulate(Simulation(scene, 1, samples=1, truth_every=100), RIG, 120, folder / "rec")
            made[scene] = reconstruct(folder / "rec", folder / "run", CONFIG, lambda _: silent, last="points")
        return made[scene]

    return run_of


def decided(run):
    return {d.about: d.choice for d in run.plan.decisions}


def test_hills_get_points_beyond_the_usual_depths(pointed):
    run = pointed("far")
    assert decided(run)["depths"] == "searched to infinity"
    away = read(run, STILL, Points).positions[:, 2]
    assert (away > 20).mean() > 0.1
    assert not run.has_array(EMPTY.format(view="cam00"))


def test_darkness_gets_no_points_and_is_kept_empty(pointed):
    run = pointed("black")
    choices = decided(run)
    assert choices["darkness"] == "kept empty"
    assert "depths" not in choices
    assert run.read_array(EMPTY.format(view="cam00")).mean() > 0.05
    light = read(run, STILL, Points).intensities
    assert np.mean(light < 0.004) < 0.2  # measured 0.15: beside movers, whose masks are kept


def test_an_ordinary_room_gets_neither(pointed):
    run = pointed("fan_and_ball")
    assert not {"depths", "darkness"} & set(decided(run))
