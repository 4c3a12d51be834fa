"""Nominal rigs: found, or refused with the reason and kept; the truth is then met in the run's own frame."""

import json
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.bench.conventions import KnownRecording
from reconstruction.bench.poses import BOARD, METHODS, Sight, bench_poses, measured
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.evaluation.evaluate import held_out_camera
from reconstruction.initialization.initialisers import INITIALISERS, InitOptions
from reconstruction.metrics.poses import pose_errors
from reconstruction.pipeline.artefacts import posed, with_cameras, write_rig
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.truth import Truth
from rigs.rig import object_distance_m
from rigs.similarity import Similarity
from rigs.toml import catalog_rig, load_rig
from server.cli.main import main

pytestmark = pytest.mark.slow
SMALL = ReconstructionConfig(holdout="cam11", steps=40, budget_s=None, seed=1, gaussians=2000)


def quiet(stage):
    return silent


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """100x64 pixels: too few features to find cameras from, and an error of the rig that stereo just bears."""
    path = tmp_path_factory.mktemp("recordings") / "small"
    simulate(Simulation("fan_and_ball", seed=3, rig_error=0.3), catalog_rig("ci3x3"), 80, path)
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The lab rig, built two degrees off its drawing."""
    path = tmp_path_factory.mktemp("recordings") / "whole"
    simulate(Simulation("fan_and_ball", seed=3, rig_error=2.0, truth_every=60), catalog_rig("lab3x3"), 120, path)
    return path


def true_rig(path):
    recording = Recording.open(path)
    assert recording.truth is not None
    found = Truth.open(recording.truth).cameras(recording.tick_rate_hz)
    assert found is not None
    return found.only(recording.camera_ids)


def test_a_part_with_found_cameras_keeps_its_ticks(small, tmp_path):
    part = Recording.open(small).part(24, 64)
    write_rig(tmp_path / "found.toml", part.rig)
    found = with_cameras(part, load_rig(tmp_path / "found.toml"))
    assert found.ticks == range(24, 64)
    assert found.rig.clock.instant_s(0) == part.rig.clock.instant_s(0)
    same = [one.stream("cam11").planes(0, 40) for one in (found, part)]
    np.testing.assert_array_equal(*same)


def off(found, true):
    return pose_errors(found, true, object_distance_m(true.cameras))


def test_a_nominal_rig_is_calibrated_from_its_scene(whole, tmp_path):
    run = reconstruct(whole, tmp_path / "run", replace(SMALL, init="auto"), quiet, last="poses")
    recording, true = Recording.open(whole), true_rig(whole)
    assert off(recording.rig, true).rotation_deg > 1
    views = run.plan.views  # the held-out camera is not looked at, so it stays where the drawing has it
    assert off(posed(run, recording).rig.only(views), true.only(views)).rotation_deg < 0.03
    assert run.document.poses is not None
    assert run.document.poses["held_out_used"] is False
    (decision,) = (d for d in run.plan.decisions if d.about == "poses")
    assert "tracks" in decision.reason
    assert not run.plan.refine


def test_the_commands_calibrate_and_check(whole, tmp_path, monkeypatch, capsys):
    def spike4dgs(*args):
        monkeypatch.setattr(sys, "argv", ["spike4dgs", *map(str, args)])
        with pytest.raises(SystemExit) as caught:
            main()
        return caught.value.code

    rig = tmp_path / "rig.toml"
    assert spike4dgs("calibrate", whole, "--natural", "--out", rig, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rotation_sd_deg"] < 0.03
    assert (tmp_path / "rig-residuals.png").stat().st_size > 10_000
    assert spike4dgs("check-rig", whole) == 1  # it is still the drawing that is stored with the recording
    said = capsys.readouterr().out
    assert "cam00: stands elsewhere than drawn: " in said
    assert f"calibrate the rig: `spike4dgs calibrate {whole} --natural --out RIG.toml`" in said
    shutil.copytree(whole, tmp_path / "rec")
    shutil.copy(rig, tmp_path / "rec/rig.toml")
    assert spike4dgs("check-rig", tmp_path / "rec") == 0
    assert "still fits" in capsys.readouterr().out


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long) for n in ("sfm", "msdi")])
def test_other_initialisers_find_it_too(whole, name):
    recording, true = Recording.open(whole), true_rig(whole)
    found = INITIALISERS[name](recording, recording.camera_ids, InitOptions(), silent)
    assert off(found.rig, true).rotation_deg < 0.15
    assert len(found.points) == len(found.confidence) > 200


def test_without_a_checkpoint_dust3r_says_what_to_give(whole):
    recording = Recording.open(whole)
    with pytest.raises(BadRunError, match="--dust3r-checkpoint"):
        INITIALISERS["dust3r"](recording, recording.camera_ids, InitOptions(), silent)


def test_what_cannot_be_trusted_is_refused_and_the_nominal_rig_refined(small, tmp_path):
    run = reconstruct(small, tmp_path / "run", SMALL, quiet)
    assert run.document.poses is not None
    assert "tracks" in str(run.document.poses["refused"])
    assert run.plan.init == "sweep"
    assert run.plan.refine
    recording = Recording.open(small)
    assert posed(run, recording).rig is recording.rig
    refined = posed(run, recording, refined=True).rig
    assert off(refined, recording.rig).rotation_deg > 1e-4
    assert run.document.refinement is not None
    assert set(run.document.refinement) == set(run.plan.views)
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert metrics["psnr_db"] > 10
    assert metrics["poses.drawn.rotation_deg"] == metrics["poses.found.rotation_deg"]
    assert metrics["poses.refined.rotation_deg"] != metrics["poses.found.rotation_deg"]


def test_by_name_a_refusal_is_an_error(small, tmp_path):
    with pytest.raises(GeometryError, match="tracks"):
        reconstruct(small, tmp_path / "run", replace(SMALL, init="natural"), quiet, last="poses")


def test_refinement_resumes_to_the_bit(small, tmp_path):
    config = replace(SMALL, init="sweep", refine="on", steps=12)
    whole_run = reconstruct(small, tmp_path / "whole", config, quiet, last="train")
    reconstruct(small, tmp_path / "cut", config, quiet, last="points")
    stops = iter([False] * 6 + [True])
    with pytest.raises(StoppedError):
        reconstruct(small, tmp_path / "cut", config, quiet, last="train", should_stop=lambda: next(stops))
    cut = reconstruct(small, tmp_path / "cut", config, quiet, last="train")
    one, other = (posed(run, Recording.open(small), refined=True).rig for run in (whole_run, cut))
    for a, b in zip(one.cameras, other.cameras, strict=True):
        np.testing.assert_array_equal(a.cam_from_rig.matrix, b.cam_from_rig.matrix)


def test_the_truth_is_met_in_the_frame_of_the_run(small):
    recording, true = Recording.open(small), true_rig(small)
    views = [c for c in true.ids if c != "cam11"]
    carried = Similarity(1.5, np.eye(3), np.array([0.1, 0.2, 0.3])).carry_rig(true)
    truth = Truth.open(small / "truth")
    held_out, scaled = held_out_camera(replace(recording, rig=carried), "cam11", views, truth)
    np.testing.assert_allclose(held_out.camera.center, carried.camera("cam11").center, atol=1e-9)
    assert scaled is not None
    plane = truth.planes("cam11")[0]
    np.testing.assert_allclose(scaled.frame("cam11", plane).depth, 1.5 * truth.frame("cam11", plane).depth, rtol=1e-5)


def test_the_held_out_lens_is_the_one_that_was_found(small):
    recording, true = Recording.open(small), true_rig(small)
    found = replace(true, cameras=tuple(replace(c, fx=1.01 * c.fx, fy=1.01 * c.fy) for c in true.cameras))
    views = [c for c in true.ids if c != "cam11"]
    held_out, _ = held_out_camera(replace(recording, rig=found), "cam11", views, Truth.open(small / "truth"))
    assert held_out.camera.fx == pytest.approx(1.01 * true.camera("cam11").fx)
    assert held_out.camera.fy == pytest.approx(1.01 * true.camera("cam11").fy)
    assert held_out.camera.cx == true.camera("cam11").cx


def test_the_bench_scores_what_it_is_given(small):
    clip = KnownRecording("fan_and_ball", 3, small)
    row = measured("nominal", clip, Sight(error=1.0), scored=True)
    assert 0.4 < row["rotation_deg"] < 2
    assert row["abs_rel"] > 0.01
    exact = measured("nominal", clip, Sight(error=0.0), scored=True)
    assert exact["rotation_deg"] < 1e-5
    assert exact["abs_rel"] < row["abs_rel"]
    assert "refused" in measured("natural", clip)


def test_the_bench_lists_what_was_refused(small, tmp_path):
    clip = KnownRecording("fan_and_ball", 3, small)
    document = bench_poses([clip], None, tmp_path, silent, quick=True)
    assert bench_poses([clip], None, tmp_path, silent, quick=True).rows == document.rows
    assert {r["method"] for r in document.rows} == set(METHODS) - {BOARD}
    assert any("natural: refused on 1 of 1" in omission for omission in document.omissions)
    assert any("DUSt3R" in omission for omission in document.omissions)
    assert document.summary["nominal.rotation_deg"] > 0.5
