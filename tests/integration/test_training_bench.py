"""The training bench on one small recording: its document, its sheet, and that it resumes."""

import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION
from acquisition.session.record import simulate
from reconstruction.bench.contact_sheet import run_tiles, write_sheet
from reconstruction.bench.diagrams import plot_training
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper import run as runs
from reconstruction.bench.paper.method import Batch, Effort, Protocol, Row, Table
from reconstruction.bench.paper.run import Laboratory
from reconstruction.bench.training import bench
from reconstruction.bench.training.bench import bench_training, shown_cells, training_protocol
from rigs.toml import catalog_rig

SCENE = "fan_and_ball"
SMALL = [method.changed(method.name, gaussians=3000) for method in (m.AUTO, m.CLEAN)]


@pytest.mark.slow
@pytest.mark.long
def test_a_bench_scores_what_it_ran_and_runs_nothing_twice(tmp_path, monkeypatch):
    path = tmp_path / "rec"
    simulate(Simulation(SCENE, seed=3), catalog_rig("ci3x3"), 120, path)
    laboratory = Laboratory(tmp_path / "work", lambda scene, seed: path, lambda stage: silent)
    table = Table("training", "", "", tuple(Row(method.name, method) for method in SMALL))
    protocol = Protocol((table,), (Batch("training", (SCENE,), (Effort(steps=40),)),))
    monkeypatch.setattr(bench, "MARGINS", ((SMALL[1], -1, Effort(steps=40)),))
    monkeypatch.setattr(bench, "BUDGETS", (Effort(steps=40),))
    document = bench_training(protocol, laboratory, silent).to_json()
    assert [r["method"] for r in document["rows"]] == ["auto", "clean"]
    assert all(r["steps"] == 40 and r["seconds"] > 0 and len(r["curve"]) > 2 for r in document["rows"])
    level = document["summary"]["auto.psnr_db@40steps"]
    assert level == pytest.approx(document["rows"][0]["psnr_db"], abs=1e-6)
    gap = document["rows"][1]["psnr_db"] - document["rows"][0]["psnr_db"]
    assert document["summary"]["margin.clean@40steps"] == pytest.approx(gap, abs=1e-6)
    above = level - document["rows"][0]["depth_blend.psnr_db"]
    assert document["summary"]["margin.floor@40steps"] == pytest.approx(above, abs=1e-6)
    monkeypatch.setattr(runs, "reconstruct", lambda *a, **k: pytest.fail("ran again"))
    again = bench_training(protocol, laboratory, silent).to_json()
    assert again["summary"] == document["summary"]
    plot_training(tmp_path / "training.png", document | {"rows": [r | {"budget_s": 1.0} for r in document["rows"]]})
    ((clip, run),) = laboratory.runs(protocol.cells()[:1])
    write_sheet(tmp_path / "sheet.png", [run_tiles(clip, run)])
    assert (tmp_path / "training.png").stat().st_size > 1000
    assert (tmp_path / "sheet.png").stat().st_size > 1000


@pytest.mark.parametrize("scenes", [None, ("traffic",), ("fan_and_ball", "stiff")])
def test_every_run_is_a_configuration_and_choices_are_made_on_development_scenes(scenes):
    protocol = training_protocol(scenes)
    for cell in protocol.cells():
        assert cell.method.config(cell.effort, cell.seed).budget_s == cell.effort.budget_s
        if cell.method.name.startswith(("model.", "supervision.")):
            assert cell.scene in DEVELOPMENT
    assert {cell.scene for cell in protocol.cells()} == set(scenes or (*EVALUATION, *DEVELOPMENT))
    assert [cell.effort.label for cell in shown_cells(protocol)] == ["120"] * len(scenes or EVALUATION)


def test_a_quick_bench_is_one_run_of_the_engine():
    (cell,) = training_protocol(("traffic",), quick=True).cells()
    assert cell.name == "traffic-101-auto-60"
