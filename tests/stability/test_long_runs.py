"""Tests the part `spike4dgs stability --full` adds: small drifts and trainings, and that faults in them are noticed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from acquisition.native import code_paths
from acquisition.progress import silent
from reconstruction.bench.diagrams import plot_stability
from reconstruction.pipeline.points_stage import LEAST_POINTS
from reconstruction.stability import catalogue, drift, stiff
from reconstruction.stability.case import row_of
from reconstruction.stability.catalogue import LongRuns
from reconstruction.stability.models import model_names
from reconstruction.stability.stiff import Extent, StiffScene, Trained, stiff_cases
from server.cli.stability import stability_command

MACHINE = {"device": {"processor": "a chip", "threads": 2}, "revision": "abc"}
TINY = Extent({"burst": 64}, (60, 38), 300, 20, (0, 1))


@pytest.mark.parametrize("case", drift.drift_cases(150_001, silent), ids=lambda case: case.name.replace(" ", "-"))
def test_nothing_drifts(case):
    rows = [row_of(case, backend) for backend in case.on()]
    assert [row.verdict for row in rows] == ["pass"] * len(rows), rows


@pytest.mark.parametrize("fault", ["lost", "late"])
def test_a_spike_that_is_lost_or_late_is_noticed(monkeypatch, fault):
    class Faulty(drift.Sensor):
        def expose(self, intensity):
            spikes = super().expose(intensity)
            if fault == "lost":
                spikes[np.flatnonzero(spikes[:, 0, 3])[:3], 0, 3] = 0
            else:
                spikes[:, 0, 1] = np.roll(spikes[:, 0, 1], 40)
            return spikes

    monkeypatch.setattr(drift, "Sensor", Faulty)
    rows = [row_of(case, case.on()[-1]) for case in drift.drift_cases(120_000, silent)[:1]]
    assert [row.verdict for row in rows] == ["fail"], rows


KINDS = ("burst: 2 seeds", "burst: float32", "burst: trains")  # that ask for nothing but whole trainings


def judged(scene):
    cases = [case for case in stiff_cases(scene) if case.name in KINDS]
    return {case.name: [row_of(case, on).verdict for on in case.on()] for case in cases}


def scene_of(tmp_path, **trainings):
    """A scene whose trainings are done, with these losses and scores."""
    scene, best = StiffScene("burst", tmp_path, TINY), code_paths()[-1]
    falling = tuple(np.geomspace(1, 0.5, TINY.steps))
    for path in code_paths():
        scene.done[0, "auto", False, path] = trainings.get("single", Trained(falling, 25.0))
    scene.done[1, "auto", False, best] = trainings.get("other", Trained(falling, 25.5))
    scene.done[0, "auto", True, best] = trainings.get("double", Trained(falling, 25.05))
    for model in model_names():
        scene.done[0, model, False, best] = trainings.get(model, Trained(falling, 20.0))
    return scene


def test_a_spread_a_gap_or_a_training_that_fails_is_a_failure(tmp_path):
    falling = tuple(np.geomspace(1, 0.5, TINY.steps))
    verdicts = judged(scene_of(tmp_path))
    assert [set(verdicts[kind]) for kind in KINDS] == [{"pass"}] * 3
    assert judged(scene_of(tmp_path, other=Trained(falling, 27.1)))[KINDS[0]] == ["fail"]
    assert set(judged(scene_of(tmp_path, double=Trained(falling, 25.2)))[KINDS[1]]) == {"fail"}
    for losses in ((*falling[:-1], np.nan), (1.0,) * TINY.steps):
        found = judged(scene_of(tmp_path, cubic=Trained(losses, 20.0)))[KINDS[2]]
        assert [v == "fail" for v in found] == [name == "cubic" for name in model_names()]


def test_a_model_may_have_fewer_gaussians_than_a_recording_needs_points(tmp_path):
    few = replace(TINY, gaussians=200)
    assert StiffScene("burst", tmp_path, few).run(0, "linear").plan.still_gaussians < LEAST_POINTS


def test_curves_are_drawn(tmp_path):
    scene = scene_of(tmp_path)
    curves = {"burst": stiff.curves(scene), "untrained": stiff.curves(StiffScene("dim", tmp_path, TINY))}
    assert {name: list(found) for name, found in curves.items()} == {"burst": ["float32", "float64"], "untrained": []}
    plot_stability(tmp_path / "curves.png", {"curves": curves, **MACHINE})
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("full", "verdict"), [(False, "pass"), (True, "fail")])
def test_the_command_keeps_what_it_prints(tmp_path, monkeypatch, full, verdict):
    row = {"case": "1 x", "backend": "none", "expected": "a", "observed": "b"}
    row |= {"error": 1e-6, "gradient": None, "verdict": verdict}
    document = {"rows": [row], "omissions": ["c"], "summary": {"cases": 1, "failed": int(verdict == "fail")}, **MACHINE}
    document |= {"curves": {"burst": {}}} if full else {}
    asked = []
    monkeypatch.setattr("server.cli.stability.run_catalogue", lambda _, runs: asked.append(runs) or document)
    result = CliRunner().invoke(stability_command, ["--out", str(tmp_path / "new"), *["--full"] * full])
    assert result.exit_code == document["summary"]["failed"]
    assert asked == [LongRuns() if full else None]
    assert json.loads((tmp_path / "new" / "stability.json").read_text()) == document
    assert (tmp_path / "new" / "stability.png").exists() == full
    assert result.stdout.splitlines()[1].split() == ["1", "x", "none", "a", "b", "1.0e-06", verdict]


@pytest.mark.slow
def test_the_long_runs_make_rows_and_curves(monkeypatch):
    monkeypatch.setattr(catalogue, "CASES", ())
    document = catalogue.run_catalogue(silent, LongRuns(120_000, TINY))
    failed = [row for row in document["rows"] if row["verdict"] == "fail"]
    assert failed == []
    assert {row["case"] for row in document["rows"]} > {*KINDS, "burst: killed and resumed"}
    curves = document["curves"]["burst"]
    assert {name: len(losses) for name, losses in curves.items()} == {"float32": TINY.steps, "float64": TINY.steps}
    assert curves["float32"] != curves["float64"]
