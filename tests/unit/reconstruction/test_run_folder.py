import json
from dataclasses import replace

import numpy as np
import pytest

from acquisition.durable import write_durably
from acquisition.errors import DiskError
from reconstruction.errors import BadRunError
from reconstruction.pipeline.poses_stage import _refine
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.decisions import Decision, Plan
from reconstruction.run.document import BodyCounts, Elements
from reconstruction.run.folder import RunFolder
from reconstruction.run.spans import Span
from reconstruction.tensors import write_tensors
from reconstruction.training.checkpoint import load_checkpoint

CONFIG = ReconstructionConfig(steps=5, budget_s=None)


def start(tmp_path, config=CONFIG):
    return RunFolder.start(tmp_path / "run", config, tmp_path / "rec", "revision")


def test_an_unfinished_run_resumes_with_the_same_configuration(tmp_path):
    start(tmp_path).finish_stage("plan", 1.5)
    again = start(tmp_path)
    assert again.has("plan")
    assert again.config == CONFIG


def test_another_configuration_is_refused(tmp_path):
    start(tmp_path)
    with pytest.raises(BadRunError, match="another configuration"):
        start(tmp_path, ReconstructionConfig(steps=6, budget_s=None))


def test_a_run_of_before_there_was_a_device_resumes(tmp_path):
    file = start(tmp_path).path / "run.json"
    document = json.loads(file.read_text())
    assert document["configuration"].pop("device") == "auto"
    file.write_text(json.dumps(document))
    assert start(tmp_path).config == CONFIG


def test_a_finished_run_is_not_overwritten(tmp_path):
    run = start(tmp_path)
    run.document.status = "finished"
    run.save()
    with pytest.raises(BadRunError, match="found a finished run"):
        start(tmp_path)


def test_the_last_stage_finishes_the_run(tmp_path):
    start(tmp_path).finish_stage("report", 1.5, last=True)
    document = RunFolder.open(tmp_path / "run").document
    assert (document.status, document.seconds) == ("finished", {"report": 1.5})


def test_a_folder_of_other_things_is_refused(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("x")
    with pytest.raises(BadRunError, match="something that is not a run"):
        start(tmp_path)
    assert (tmp_path / "run" / "thesis.tex").exists()


def test_a_second_process_is_kept_out(tmp_path):
    run = start(tmp_path)
    with run.locked(), pytest.raises(BadRunError, match="another process"), RunFolder.open(run.path).locked():
        pass
    with run.locked():
        pass


@pytest.mark.parametrize("content", ["", "{", '{"schema": 99}'])
def test_a_broken_run_json_is_refused(tmp_path, content):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text(content)
    with pytest.raises(BadRunError, match=r"run\.json"):
        RunFolder.open(tmp_path / "run")


def test_arrays_round_trip_and_a_missing_one_names_itself(tmp_path):
    run = start(tmp_path)
    run.write_array("points/still_positions", np.arange(6.0).reshape(2, 3))
    assert run.read_array("points/still_positions").tolist() == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(BadRunError, match=r"moving_positions\.npy: not found"):
        run.read_array("points/moving_positions")


def test_a_damaged_checkpoint_is_refused_without_running_it(tmp_path):
    file = tmp_path / "checkpoint.pt"
    write_tensors(file, {"steps": 3})
    assert load_checkpoint(file) == {"steps": 3}
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(BadRunError, match="no readable checkpoint"):
        load_checkpoint(file)


def test_a_refused_write_leaves_the_old_file(tmp_path, monkeypatch):
    file = tmp_path / "run.json"
    write_durably(file, "old")

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(DiskError, match="No space left"):
        write_durably(file, "new")
    assert file.read_text() == "old"
    assert [f.name for f in tmp_path.iterdir()] == ["run.json"]


def test_run_json_is_plain(tmp_path):
    document = json.loads((start(tmp_path).path / "run.json").read_text())
    assert document["status"] == "unfinished"
    assert document["configuration"]["steps"] == 5


PLAN = Plan(
    ("cam00", "cam01"), "bases", "tfi", "image-variation", 10, 20, (Decision("motion", "bases", "moves", "--model"),)
)
LINEAR = Decision("motion", "linear", "straight paths explain more", "--model", facts={"bases_error_spikes": 0.2})


def test_what_later_stages_saw_is_kept_beside_the_plan_as_it_was_made(tmp_path):
    run = start(tmp_path)
    run.document.planned = PLAN
    run.amend("train", LINEAR, model="linear")
    opened = RunFolder.open(run.path)
    assert (opened.document.planned, opened.plan.model) == (PLAN, "linear")
    assert LINEAR in opened.plan.decisions
    shown = json.loads((run.path / "run.json").read_text())
    assert (shown["plan"]["model"], shown["planned"]["model"]) == ("linear", "bases")
    assert [d["choice"] for d in shown["plan"]["decisions"]] == ["linear"]
    assert shown["held_out_used"] is False


def test_an_amendment_about_the_same_thing_gives_way_to_a_later_one(tmp_path):
    run = start(tmp_path)
    run.document.planned = PLAN
    run.amend("train", LINEAR, model="linear")
    run.amend("train", LINEAR, model="linear")
    assert len(run.document.amendments) == 1


def test_a_run_of_an_earlier_revision_is_read(tmp_path):
    run = start(tmp_path)
    run.document.planned = PLAN
    run.save()
    document = json.loads((run.path / "run.json").read_text())
    for key in ("planned", "amendments", "held_out_used", "attempt"):
        del document[key]
    document["configuration"]["supervision"] = document["plan"]["supervision"] = "variation"
    del document["configuration"]["device"], document["plan"]["spans"]
    for decision in document["plan"]["decisions"]:
        del decision["facts"]
    document |= {
        "steps": 7,
        "cells": {"still": 3, "moving": 4},
        "bodies": {"rigid": 1, "attached": 2, "free": {"far": 3}},
    }
    (run.path / "run.json").write_text(json.dumps(document))
    old = RunFolder.open(run.path)
    assert old.plan == PLAN
    assert old.config.supervision == "image-variation"
    assert old.document.held_out_used is None
    assert (old.document.steps, old.document.elements) == (7, Elements("cells", 3, 4))
    assert old.document.bodies == BodyCounts(1, 2, {"far": 3})


def test_forgetting_undoes_what_a_stage_told_and_what_another_attempt_may_lack(tmp_path):
    run = start(tmp_path)
    run.document.planned, run.document.poses, run.document.steps = PLAN, {"init": "sweep"}, 7
    run.amend("poses", Decision("poses", "nominal, as given", "refused", "--init"), init="sweep")
    run.amend("train", LINEAR, model="linear")
    kept = ("plan/light.npy", "poses/elsewhere.toml", "images/uneven.npy")
    gone = ("poses/rig.toml", "poses/refined.toml", "poses/held_out.toml", "points/empty_cam00.npy", "evidence.pt")
    for name in (*kept, *gone):
        (run.path / name).parent.mkdir(exist_ok=True)
        (run.path / name).write_text("of the first attempt")
    run.forget(["train", "report"], 1)
    assert (run.plan.model, run.plan.init, run.document.steps) == ("bases", "sweep", None)
    assert [(run.path / name).exists() for name in gone] == [True, False, False, True, False]
    run.forget(["poses", "images", "points", "train", "report"], 2)
    assert RunFolder.open(run.path).document.amendments == []
    assert run.document.poses is None
    assert not any((run.path / name).exists() for name in gone)
    assert all((run.path / name).exists() for name in kept)


def test_only_an_attempt_to_come_resumes_a_finished_run(tmp_path):
    run = start(tmp_path)
    run.finish_stage("report", 1.0, last=True)

    def resumed(attempt, config=CONFIG):
        return RunFolder.start(run.path, config, tmp_path / "rec", "revision", attempt=attempt)

    assert resumed(1).document.status == "finished"
    with pytest.raises(BadRunError, match=r"a run \(finished\) with another configuration"):
        resumed(1, ReconstructionConfig(steps=6, budget_s=None))
    run.forget(["report"], 1)
    run.finish_stage("report", 1.0, last=True)
    with pytest.raises(BadRunError, match="found a finished run"):
        resumed(1)


@pytest.mark.parametrize(("spans", "refines"), [((), True), ((Span(0, 200), Span(200, 400)), False)])
def test_poses_in_doubt_are_refined_in_one_piece_alone(tmp_path, spans, refines):
    run = start(tmp_path)
    run.document.planned = replace(PLAN, spans=spans)
    _refine(run, "they are nominal")
    assert run.plan.refine is refines
    (said,) = (d for d in run.plan.decisions if d.about == "refinement")
    assert "they are nominal" in said.reason
    assert said.choice.startswith("poses, gains and lags" if refines else "none: spans")
