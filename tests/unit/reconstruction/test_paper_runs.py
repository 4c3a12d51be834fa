"""Cells of the paper's bench: run once, found again, refused with a reason, left out when time is up."""

import json
import shutil
from functools import partial
from types import SimpleNamespace

import pytest

from acquisition.errors import AcquisitionError
from acquisition.progress import silent
from reconstruction.bench.paper import digest
from reconstruction.bench.paper import run as runs
from reconstruction.bench.paper.bench import bench_paper, lacks_runs, timer
from reconstruction.bench.paper.method import Batch, Cell, Effort, Method, Protocol, Row, Table
from reconstruction.bench.paper.run import SCORES, Laboratory
from reconstruction.errors import BadRunError, StereoError
from server.cli.bench_asked import Asked

EFFORT = Effort(10.0)
GOOD, BAD, UNKNOWN = Method("good"), Method("bad", {"images": "tfi"}), Method("unknown", {"model": "nerf"})
TABLE = Table("t", "T", "", (*(Row(m.name, m) for m in (GOOD, BAD, UNKNOWN)), Row("none", omitted="no licence")))
PROTOCOL = Protocol((TABLE,), (Batch("t", ("fan_and_ball",), (EFFORT,)),))
SCORED = {"psnr_db": 30.0, "ssim": 0.9, "abs_rel": 0.1, "curve": [{"seconds": 9.5, "psnr_db": 30.0}]}


@pytest.fixture
def laboratory(tmp_path, monkeypatch):
    recording = tmp_path / "fan_and_ball-2"
    recording.mkdir()
    (recording / "recording.json").write_text("{}")
    made = []

    def reconstruct(path, out, config, progress_of, *, last):
        assert (path, last) == (recording, "train")
        made.append(out.parent.name)
        assert not out.exists()
        if config.images == "tfi":
            raise StereoError("found no depth", where=tmp_path / "work" / "recordings" / "one")
        for name in ("points/still.npy", "snapshots/0000001.pt", "snapshots/0000002.pt", "run.json", "checkpoint.pt"):
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (out / name).touch()

    monkeypatch.setattr(runs, "reconstruct", reconstruct)
    monkeypatch.setattr(runs, "score_run", lambda run, recording, floors: SCORED)
    monkeypatch.setattr(runs.Recording, "open", lambda path: path)
    monkeypatch.setattr(runs, "Stolen", lambda: SimpleNamespace(share=lambda: 0.0))  # whatever else this machine does
    found = Laboratory(tmp_path / "work", lambda scene, seed: tmp_path / f"{scene}-{seed}", lambda name: silent)
    found.warm, found.pace = True, lambda: 10.0
    return SimpleNamespace(own=found, made=made, recording=recording)


def test_what_was_run_is_found_again_and_what_was_refused_has_its_reason(laboratory):
    document = bench_paper(PROTOCOL, laboratory.own, silent)
    assert laboratory.made == ["fan_and_ball-2-good-10", "fan_and_ball-2-bad-10"]
    (row,) = document.rows
    assert (row["method"], row["scene"], row["seed"], row["effort"], row["seconds"]) == (
        *("good", "fan_and_ball", 2, "10", 9.5),
    )
    assert document.summary["t.good.psnr_db@10"] == 30.0
    assert document.summary["t.good.seconds@10"] == 9.5
    assert "t, bad: recordings/one: found no depth (fan_and_ball-2 @10)" in document.omissions
    assert "t, none: no licence" in document.omissions
    assert any(line.startswith("t, unknown: found model 'nerf', expected one of") for line in document.omissions)
    again = bench_paper(PROTOCOL, laboratory.own, silent)
    assert (again.rows, again.omissions, again.summary) == (document.rows, document.omissions, document.summary)
    assert len(laboratory.made) == 2


def test_a_cell_whose_recording_cannot_be_made_was_not_run(laboratory):
    def recording_of(scene, seed):
        raise AcquisitionError("found that simulate failed", where=f"{scene}-{seed}")

    laboratory.own.recording_of = recording_of
    document = bench_paper(PROTOCOL, laboratory.own, silent)
    reason = "not run yet, fan_and_ball-2: found that simulate failed (fan_and_ball-2 @10)"
    assert f"t, good: {reason}" in document.omissions
    assert lacks_runs(document.omissions, "t")
    assert document.rows == document.refused == []


def test_a_run_that_fails_is_named_and_the_bench_goes_on(laboratory, monkeypatch, capsys):
    monkeypatch.setattr(runs, "score_run", lambda run, recording, floors: SCORED["mse"])
    document = bench_paper(PROTOCOL, laboratory.own, silent)
    assert "t, good: the program failed, KeyError: 'mse' (fan_and_ball-2 @10)" in document.omissions
    assert laboratory.made == ["fan_and_ball-2-good-10", "fan_and_ball-2-bad-10"]
    assert "Traceback" in capsys.readouterr().err
    assert bench_paper(PROTOCOL, laboratory.own, silent).omissions == document.omissions


def test_a_run_that_came_to_training_too_late_is_named(laboratory, monkeypatch):
    late = SCORED | {"curve": [{"seconds": 12.0, "psnr_db": 30.0}]}
    monkeypatch.setattr(runs, "score_run", lambda run, recording, floors: late)
    document = bench_paper(PROTOCOL, laboratory.own, silent)
    assert any(line.startswith("fan_and_ball-2-good-10: took 12 s: the stages") for line in document.omissions)


def test_of_a_run_its_scores_and_its_last_state_are_left(laboratory):
    bench_paper(PROTOCOL, laboratory.own, silent)
    (folder,) = (laboratory.own.work / "cells" / "fan_and_ball-2-good-10").iterdir()
    left = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert left == {SCORES, "run.json", "snapshots/0000002.pt"}


@pytest.mark.parametrize(("shares", "kept"), [([0.1], 0.1), ([0.5, 0.2], 0.2), ([0.2, 0.5], 0.2)])
def test_a_run_that_others_disturbed_is_run_again_and_the_quieter_counts(laboratory, monkeypatch, shares, kept):
    took = iter(shares)
    monkeypatch.setattr(runs, "Stolen", lambda: SimpleNamespace(share=lambda: next(took)))
    found = laboratory.own.result(Cell(GOOD, "fan_and_ball", 2, EFFORT))
    assert found["stolen"] == kept
    assert len(laboratory.made) == len(shares)
    (folder,) = (laboratory.own.work / "cells" / "fan_and_ball-2-good-10").iterdir()
    assert json.loads((folder / SCORES).read_text()) == found
    assert (folder / "run.json").exists()


@pytest.mark.parametrize(
    ("paces", "made"), [([10, 10, 13, 13, 10, 10], 3), ([10, 10, 12, 12], 2), ([10, 10, 13, 13, 14, 14], 3)]
)
def test_a_run_on_a_machine_that_had_become_slower_is_run_again(laboratory, paces, made):
    took = iter(paces)
    laboratory.own.pace = lambda: next(took)
    rows = [laboratory.own.result(Cell(GOOD, "fan_and_ball", 2, Effort(seconds))) for seconds in (10.0, 11.0)]
    assert [row["step_ms"] for row in rows] == [10, min(paces[3], paces[-1])]
    assert len(laboratory.made) == made


def test_a_slow_machine_weighs_more_than_ten_thousandths_that_were_stolen(laboratory, monkeypatch):
    took, shares = iter([10, 10, 30, 30, 11, 11]), iter([0.0, 0.0002, 0.0003])
    laboratory.own.pace = lambda: next(took)
    monkeypatch.setattr(runs, "Stolen", lambda: SimpleNamespace(share=lambda: next(shares)))
    rows = [laboratory.own.result(Cell(GOOD, "fan_and_ball", 2, Effort(seconds))) for seconds in (10.0, 11.0)]
    assert [(row["step_ms"], row["stolen"]) for row in rows] == [(10, 0.0), (11, 0.0003)]


def test_a_run_of_steps_is_not_run_again_for_a_slower_machine(laboratory):
    took = iter([10, 10, 99, 99])
    laboratory.own.pace = lambda: next(took)
    rows = [laboratory.own.result(Cell(GOOD, "fan_and_ball", 2, Effort(steps=steps))) for steps in (5, 6)]
    assert [row["step_ms"] for row in rows] == [10, 99]
    assert len(laboratory.made) == 2


def test_other_code_makes_a_result_stale_unless_it_is_to_be_kept(laboratory, monkeypatch):
    before = bench_paper(PROTOCOL, laboratory.own, silent)
    monkeypatch.setattr(digest, "code_digest", lambda method: "other")
    laboratory.own.keep = True
    recording_of = laboratory.own.recording_of
    laboratory.own.recording_of = lambda scene, seed: pytest.fail("simulated for nothing")
    kept = bench_paper(PROTOCOL, laboratory.own, silent)
    laboratory.own.recording_of = recording_of
    assert len(laboratory.made) == 2
    assert kept.rows == [row | {"kept": True} for row in before.rows]
    assert any(before.rows[0]["revision"] in line for line in kept.omissions if line.startswith("kept from"))
    laboratory.own.keep = False
    bench_paper(PROTOCOL, laboratory.own, silent)
    assert len(laboratory.made) == 4


def test_a_bench_goes_on_by_its_document_where_its_folder_is_gone(laboratory, tmp_path, monkeypatch):
    before = bench_paper(PROTOCOL, laboratory.own, silent)
    document = tmp_path / "paper.json"
    document.write_text(json.dumps(before.to_json() | {"rows": [*before.rows, {"part": "of another kind"}]}))
    shutil.rmtree(laboratory.own.work / "cells")
    laboratory.own.earlier = Asked(tmp_path, lambda name: silent, document).earlier_rows()
    laboratory.made.clear()
    again = bench_paper(PROTOCOL, laboratory.own, silent)
    assert (again.rows, again.omissions, laboratory.made) == (before.rows, before.omissions, [])
    monkeypatch.setattr(digest, "code_digest", lambda method: "other")
    cell = Cell(GOOD, "fan_and_ball", 2, EFFORT)
    assert laboratory.own.known(cell) is None
    laboratory.own.keep = True
    assert laboratory.own.known(cell) == before.rows[0] | {"kept": True}


def test_rows_of_other_code_outlive_a_bench_that_does_not_begin_their_cells(laboratory, tmp_path, monkeypatch):
    before = bench_paper(PROTOCOL, laboratory.own, silent)
    document = tmp_path / "paper.json"
    other = Table("u", "U", "", (Row("good", GOOD),))
    both = Protocol((TABLE, other), (*PROTOCOL.batches, Batch("u", ("fan_and_ball",), (Effort(20.0),))))
    shutil.rmtree(laboratory.own.work / "cells")
    monkeypatch.setattr(digest, "code_digest", lambda method: "other")
    found = before
    for protocol, limit_s in ((both.beginning(("u",)), None), (both, 0.0)):
        document.write_text(json.dumps(found.to_json()))
        laboratory.own.earlier = Asked(tmp_path, lambda name: silent, document).earlier_rows()
        found = bench_paper(protocol, laboratory.own, silent, timer(limit_s))
        assert [row for row in found.rows if row["effort"] == "10"] == [row | {"kept": True} for row in before.rows]
        assert "t, bad: recordings/one: found no depth (fan_and_ball-2 @10)" in found.omissions
        assert f"kept from other code, at the revisions {before.rows[0]['revision']}" in found.omissions
    assert laboratory.made[2:] == ["fan_and_ball-2-good-20"]
    again = bench_paper(both, laboratory.own, silent)
    assert {row["code"] for row in (*again.rows, *again.refused)} == {"other"}


def test_a_first_call_has_no_earlier_rows(tmp_path):
    assert Asked(tmp_path, lambda name: silent).earlier_rows() == {}
    assert Asked(tmp_path, lambda name: silent, tmp_path / "none.json").earlier_rows() == {}


def test_when_time_is_up_no_run_begins_and_what_is_missing_is_named(laboratory):
    seconds = iter([0.0, 0.0, 99.0, 99.0, 99.0])
    document = bench_paper(PROTOCOL, laboratory.own, silent, timer(50.0, lambda: next(seconds)))
    assert laboratory.made == ["fan_and_ball-2-good-10"]
    assert "t, bad: not run yet (fan_and_ball-2 @10)" in document.omissions


def test_runs_are_begun_for_the_tables_asked_for_and_kept_of_the_others(laboratory):
    other = Table("u", "U", "", (Row("good", GOOD),))
    both = Protocol((TABLE, other), (*PROTOCOL.batches, Batch("u", ("fan_and_ball",), (Effort(20.0),))))
    bench_paper(PROTOCOL, laboratory.own, silent)
    laboratory.made.clear()
    document = bench_paper(both.beginning(("u",)), laboratory.own, silent)
    assert laboratory.made == ["fan_and_ball-2-good-20"]
    assert {(row["method"], row["effort"]) for row in document.rows} == {("good", "10"), ("good", "20")}
    with pytest.raises(BadRunError, match="some of t, u"):
        both.beginning(("v",))


def test_runs_are_begun_on_the_scenes_asked_for(laboratory):
    both = Protocol((TABLE,), (*PROTOCOL.batches, Batch("t", ("traffic",), (EFFORT,))))
    document = bench_paper(both.beginning_on(("fan_and_ball",)), laboratory.own, silent)
    assert {name.split("-")[0] for name in laboratory.made} == {"fan_and_ball"}
    assert "t, good: not run yet (traffic-101 @10)" in document.omissions
    assert both.beginning_on(("traffic",)).begins() == both.begins() - PROTOCOL.begins()
    with pytest.raises(BadRunError, match="some of fan_and_ball, traffic"):
        both.beginning_on(("fan",))


def test_no_recording_is_made_of_what_will_not_be_run(laboratory):
    laboratory.own.recording_of = lambda scene, seed: pytest.fail("simulated for nothing")
    document = bench_paper(PROTOCOL, laboratory.own, silent, timer(0.0))
    assert document.rows == []


def test_what_a_stopped_run_of_other_code_left_is_removed(laboratory):
    cell = Cell(GOOD, "fan_and_ball", 2, EFFORT)
    left_over = laboratory.own.work / "cells" / cell.name / "0123456789ab" / "points"
    left_over.mkdir(parents=True)
    laboratory.own.result(cell)
    assert not left_over.exists()


def test_the_digest_follows_choices_spikes_and_code(laboratory, monkeypatch):
    of = digest.cell_digest
    cell, recording = Cell(GOOD, "fan_and_ball", 2, EFFORT), laboratory.recording
    known = of(cell, recording)
    assert known == of(Cell(Method("good"), "fan_and_ball", 2, Effort(10.0)), recording)
    assert known != of(Cell(GOOD.changed("good", gaussians=5), "fan_and_ball", 2, EFFORT), recording)
    assert known != of(Cell(GOOD, "fan_and_ball", 2, Effort(11.0)), recording)
    (recording / "recording.json").write_text(json.dumps({"sha256": "1"}))
    assert known != of(cell, recording)


def test_code_is_what_makes_results_not_what_shows_them(tmp_path, monkeypatch):
    names = {name for name, _ in digest._sources("auto", False)}
    wanted = {"rigs/rig.py", "acquisition/spikes/sensor.cpp", "acquisition/scenes/catalog.py"}
    assert wanted | {"reconstruction/training/trainer.py", "reconstruction/rendering/frame.h"} <= names
    assert not [n for n in names if n.split("/")[1] in ("bench", "stability", "report", "export", "recording")]
    for folder in ("training", "bench"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.py").write_text("a = 1")
    monkeypatch.setattr(digest, "reconstruction", SimpleNamespace(__name__="reconstruction", __path__=[str(tmp_path)]))
    code = partial(digest._digest_of.__wrapped__, "auto", False)
    before = code()
    (tmp_path / "bench" / "a.py").write_text("a = 2")
    assert code() == before
    (tmp_path / "training" / "a.py").write_text("a = 2")
    assert code() != before


SOURCE = """
def halved(x):
    if x < 0:
        raise ValueError(f"found {x}") from None
    return x / 2
"""


@pytest.mark.parametrize(
    ("change", "by", "counts"),
    [
        ("def halved(x):", 'def halved(x):\n    """Return half of x."""  # and no more', False),
        ("\n    if", "\n\n    # negative ones\n    if", False),
        ('f"found {x}"', 'f"found {x}, expected 0 or more"', False),
        ("ValueError", "TypeError", True),
        ("x < 0", "x <= 0", True),
        ("x / 2", "x // 2", True),
        ("x / 2", "x / 2.5", True),
    ],
)
def test_only_what_a_run_can_notice_of_python_counts(change, by, counts, tmp_path):
    (tmp_path / "before.py").write_text(SOURCE)
    (tmp_path / "after.py").write_text(SOURCE.replace(change, by))
    assert SOURCE.replace(change, by) != SOURCE
    assert (digest._meaning(tmp_path / "before.py") != digest._meaning(tmp_path / "after.py")) == counts


@pytest.mark.parametrize(
    ("choices", "own", "networks"),
    [
        ({}, {"ours"}, False),
        ({"model": "stg", "images": "tfi"}, {"stg"}, False),
        ({"model": "4dgs-small", "images": "clean"}, {"four_dgs"}, False),
        ({"images": "spk2imgnet"}, {"ours"}, True),
        ({"model": "4dgs", "init": "msdi"}, {"four_dgs"}, True),
    ],
)
def test_methods_and_networks_count_where_they_are_used(choices, own, networks, monkeypatch):
    seen = []
    monkeypatch.setattr(digest, "_digest_of", lambda *used: seen.append(used) or "")
    digest.code_digest(Method("any", choices))
    names = {name for name, _ in digest._sources(*seen[0])}
    methods = {name.split("/")[2] for name in names if name.startswith("reconstruction/methods/")}
    assert methods == {f"{name}.py" for name in (*digest.OF_ALL_METHODS, *own)}
    assert ("reconstruction/networks/msdi/weights/small.npz" in names) == networks
    assert not [name for name in names if "networks/train" in name or "scenes/random/" in name]
