"""The search of learning rates: as many trials for every method, all in reach, and the best of them told."""

import math
from dataclasses import asdict

import pytest
import torch

from reconstruction.bench import tuning
from reconstruction.bench.paper.bench import NOT_RUN, UNPRINTED
from reconstruction.bench.tuning import BETWEEN, METHODS, REACH, TRIALS, bench_tuning, trials, tuning_protocol
from reconstruction.errors import BadRunError
from reconstruction.methods.catalogue import METHODS as ALL
from reconstruction.methods.definition import AS_KIND, RateFactors
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.scene_model import Rate
from reconstruction.training.optimizer import optimizer_of

ALL_ONE = Rate(1.0)
ABOUT = {"revision": "abc", "device": {"processor": "p", "threads": 2}}
UNITS = {"none": 1.0, "scene": 2.0, "light": 1.0}


class Told:
    """A laboratory that knows the result of every run at once."""

    def __init__(self, level):
        self.level, self.asked = level, []

    def known(self, cell):
        self.asked.append(cell)
        number = int(cell.method.name.split(BETWEEN)[1])
        row = {"method": cell.method.name, "scene": cell.scene, "seed": cell.seed, "effort": cell.effort.label}
        return row | {"psnr_db": self.level(number, cell), "budget_s": 60.0, "seconds": 60.0, "revision": "abc"}

    def older(self, cell):
        return None


def test_all_trials_are_in_reach_and_the_first_changes_nothing():
    tried = trials()
    assert tried == trials()
    assert len(tried) == len(set(tried)) == TRIALS
    assert tried[0] == AS_KIND == RateFactors(1, 1, 1)
    assert all(1 / REACH <= factor <= REACH for factors in tried for factor in factors)


def test_every_method_that_has_rates_to_tune_has_the_same_trials():
    cells = tuning_protocol(("fan_and_ball", "robot_arm")).cells()
    assert len(cells) == len({cell.name for cell in cells}) == 2 * TRIALS * len(METHODS)
    asked = {method.name: [] for method in METHODS}
    for cell in cells:
        config = cell.method.config(cell.effort, cell.seed)
        asked[cell.method.name.split(BETWEEN)[0]].append((cell.scene, config.rates))
        assert ReconstructionConfig.from_json(asdict(config)) == config
    assert len({frozenset(one) for one in asked.values()}) == 1
    models = {method.choices.get("model") for method in METHODS} - {None}
    assert models == {name for name, method in ALL.items() if method.moves and not method.ours}
    assert cells[2 * len(METHODS)].method.name.endswith(f"{BETWEEN}1")  # none is ahead by a trial


def test_the_best_is_the_one_of_the_highest_mean_over_scenes(tmp_path):
    scenes = tuning.SCENES
    levels = {0: (30, 30), 1: (34, 20), 2: (31, 33), **{n: (29, 29) for n in range(3, TRIALS)}}
    told = Told(lambda number, cell: float(levels[number][scenes.index(cell.scene)]))
    document = bench_tuning(tuning_protocol(scenes), told, lambda done, message: None, lambda: True)
    factors = trials()[2]
    for method in METHODS:
        own = {k.removeprefix(f"{method.name}."): v for k, v in document.summary.items() if k.startswith(method.name)}
        assert (own["trials"], own["first.psnr_db"], own["best.psnr_db"]) == (TRIALS, 30, 32)
        assert [own[f"best.{part}"] for part in factors._fields] == list(factors)
    assert document.rows[-1]["rates"] == list(trials()[-1])
    tuning.write_page(tmp_path / "tuning.md", asdict(document) | ABOUT)
    text = (tmp_path / "tuning.md").read_text()
    assert "| tfi+stg | 30.00 | 32.00 |" in text
    assert "`fan_and_ball` and `robot_arm`" in text


def test_a_method_that_lacks_trials_is_not_shown_and_a_trial_that_lacks_a_scene_is_none(tmp_path):
    scenes = tuning.SCENES
    told = Told(lambda number, cell: 30.0 + number)

    class Some(Told):
        def known(self, cell):
            last = cell.method.name == f"tfi+stg{BETWEEN}{TRIALS - 1}" and cell.scene == scenes[1]
            return None if last else told.known(cell)

    document = bench_tuning(tuning_protocol(scenes), Some(None), lambda done, message: None, lambda: False)
    assert document.summary["tfi+stg.trials"] == TRIALS - 1
    assert document.summary["tfi+stg.best.psnr_db"] == 30 + TRIALS - 2
    page = tmp_path / "tuning.md"
    tuning.write_page(page, asdict(document) | ABOUT)
    assert UNPRINTED in page.read_text()
    assert "| tfi" not in page.read_text()
    document.omissions = [line.replace(NOT_RUN, "refused") for line in document.omissions]
    tuning.write_page(page, asdict(document) | ABOUT)
    assert "| tfi+d3dgs |" in page.read_text()
    assert "| tfi+stg |" not in page.read_text()


@pytest.mark.parametrize("kind", ["bases", "4dgs"])
def test_factors_multiply_the_rates_of_their_part(kind, scene_with):
    cloud = scene_with(kind).cloud
    plain, other = (optimizer_of(cloud, UNITS, factors) for factors in (AS_KIND, RateFactors(0.5, 2.0, 3.0)))
    names = {id(tensor): name for name, tensor in cloud.tensors()}
    factors = {"still": 0.5, "moving": 2.0, "motion": 3.0}
    for a, b in zip(plain.param_groups, other.param_groups, strict=True):
        part = names[id(a["params"][0])].split(".")[0]
        assert b["start"] == pytest.approx(factors[part] * a["start"])
    assert {names[id(g["params"][0])].split(".")[0] for g in plain.param_groups} == set(factors)


def test_every_part_of_a_radiance_field_has_a_factor():
    class Field:
        def tensors(self):
            return [("field.densities", torch.zeros(3)), ("shifts.heads", torch.zeros(3))]

        def rates(self):
            return dict.fromkeys(("field.densities", "shifts.heads"), ALL_ONE)

    groups = optimizer_of(Field(), UNITS, RateFactors(0.5, 2.0, 3.0)).param_groups
    assert [group["start"] for group in groups] == [2.0, 3.0]


@pytest.mark.parametrize("weight", [-0.1, math.nan, math.inf])
def test_a_weight_that_is_no_number_from_nought_is_refused(weight):
    with pytest.raises(BadRunError, match="a number from 0"):
        ReconstructionConfig(spike_weight=weight)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.nan, math.inf])
def test_factors_that_are_no_positive_numbers_are_refused(factor):
    with pytest.raises(BadRunError, match="positive numbers"):
        ReconstructionConfig(rates=RateFactors(still=factor))
