"""The bench of expected errors: the fit of their weights, and which scenes are judged by which."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition.progress import silent
from acquisition.scenes.catalog import BACKGROUNDS, DEVELOPMENT, build_scene
from reconstruction.bench.uncertainty import bench
from reconstruction.bench.uncertainty.bench import ALIKE, LEAST, SeenView, bench_uncertainty, fitted, scored
from reconstruction.uncertainty.expected_error import WEIGHTS

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def drawn_view(weights, seed) -> SeenView:
    rng = np.random.default_rng(seed)
    terms = rng.exponential(1.0, (len(weights), 4000)) * 10.0 ** -np.arange(len(weights))[:, None]
    squares = (np.array(weights) @ terms + LEAST) * rng.standard_normal(4000) ** 2
    return SeenView({"scene": f"s{seed}"}, [terms[:, :1000], terms[:, 1000:]], [squares[:1000], squares[1000:]])


@pytest.mark.parametrize("weights", [(1.0, 10.0, 100.0), (2.0, 0.0, 50.0), (0.0, 3e-4, 0.0)])
def test_the_fit_finds_the_weights_that_errors_were_drawn_with(weights):
    views = [drawn_view(weights, seed) for seed in (1, 2)]
    found = fitted(views)
    scale = 10.0 ** -np.arange(3)
    np.testing.assert_allclose(found * scale, np.array(weights) * scale, atol=0.1 * max(np.array(weights) * scale))
    assert scored(views[0], found)["ratio"] == pytest.approx(1, abs=0.1)


def test_the_weights_are_those_of_the_committed_bench():
    summary = json.loads((BENCHMARKS / "uncertainty.json").read_text())["summary"]
    assert {f"weight.{name}": value for name, value in WEIGHTS.items()} == pytest.approx(
        {name: value for name, value in summary.items() if name.startswith("weight.")}
    )


def test_scenes_are_alike_where_the_same_things_move():
    movers = {scene: build_scene(scene, 1).movers for scene in (*DEVELOPMENT, *BACKGROUNDS)}
    assert {scene for scene in movers if movers[scene].keys() == movers[DEVELOPMENT[0]].keys()} == ALIKE


def test_no_scene_is_judged_by_itself_or_by_one_that_is_like_it(monkeypatch, tmp_path):
    fits = []

    def fitted_on(views):
        fits.append({view.about["scene"] for view in views})
        return np.ones(3)

    def held_out(clip, told):
        seen = drawn_view((1.0, 1.0, 1.0), 1)
        yield SeenView({"scene": clip.scene, "line": "held-out", "along_m": 0.0}, seen.terms, seen.squares), []

    monkeypatch.setattr(bench, "fitted", fitted_on)
    monkeypatch.setattr(bench, "_held_out", held_out)
    monkeypatch.setattr(bench, "_elsewhere", lambda *_: [])
    monkeypatch.setattr(bench, "load_cloud", lambda path: None)
    monkeypatch.setattr(bench, "read_uncertainty", lambda *_: object())
    monkeypatch.setattr(bench, "write_sheet", lambda *_: None)
    monkeypatch.setattr(bench, "WEIGHTS", dict.fromkeys("abc", 1.0))
    scenes = ("fan_and_ball", "plain", "sky", "robot_arm")
    runs = [(SimpleNamespace(scene=scene), SimpleNamespace(checkpoint=None)) for scene in scenes]
    document = bench_uncertainty(runs, ("robot_arm",), tmp_path / "sheet.png", silent)
    everything = {"fan_and_ball", "sky", "plain"}  # the last fit is for the weights that ship
    assert fits == [{"plain"}, {"fan_and_ball", "sky"}, {"plain"}, everything, everything]
    assert [row["scene"] for row in document.rows] == list(scenes)
    assert document.rows[1]["fitted_on"] == ["fan_and_ball", "sky"]
