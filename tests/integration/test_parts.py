"""A part of a recording from end to end, at 100x64: nothing but its planes is read, instants are those of the whole."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from reconstruction.bench.long.part import cut_out
from reconstruction.errors import BadRunError
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.plan import LEAST_WINDOW
from reconstruction.run.spans import Span
from reconstruction.training.checkpoint import load_cloud

FIRST, LAST, RATE_HZ = 80, 280, 20_000
CONFIG = ReconstructionConfig(holdout="cam11", steps=24, budget_s=None, seed=1, gaussians=3000, span=100)
PART = replace(CONFIG, from_tick=FIRST, to_tick=LAST)


def quiet(stage):
    return silent


@pytest.fixture(scope="module")
def run(long_recording, tmp_path_factory):
    return reconstruct(long_recording, tmp_path_factory.mktemp("runs") / "part", PART, quiet)


@pytest.fixture(scope="module")
def alone(long_recording, tmp_path_factory):
    """The same planes as a recording of their own."""
    folder = tmp_path_factory.mktemp("alone")
    cut_out(Recording.open(long_recording), Span(FIRST, LAST), folder / "rec")
    return reconstruct(folder / "rec", folder / "run", CONFIG, quiet)


@pytest.mark.slow
def test_a_part_is_learnt_as_if_it_had_been_recorded_alone(run, alone):
    part, own = load_cloud(run.checkpoint), load_cloud(alone.checkpoint)
    assert isinstance(part, SpannedScene)
    assert isinstance(own, SpannedScene)
    for (name, a), (_, b) in zip(part.tensors(), own.tensors(), strict=True):
        assert torch.equal(a, b), name
    for mine, theirs in zip(part.spans, own.spans, strict=True):
        np.testing.assert_allclose(mine.clip.first_s - theirs.clip.first_s, FIRST / RATE_HZ, rtol=1e-9)
        assert mine.cloud
        assert theirs.cloud
        np.testing.assert_allclose(mine.cloud.clip.last_s - theirs.cloud.clip.last_s, FIRST / RATE_HZ, rtol=1e-9)
    assert (part.clip.first_s, part.clip.last_s) == (FIRST / RATE_HZ, LAST / RATE_HZ)


@pytest.mark.slow
def test_a_part_is_scored_at_its_own_instants(run, alone):
    mine, theirs = (json.loads((one.path / "metrics.json").read_text()) for one in (run, alone))
    assert [(row["first_tick"], row["last_tick"]) for row in mine["spans"]] == [(80, 179), (180, 279)]
    for name, score in theirs.items():
        if name.endswith("psnr_db"):
            assert mine[name] == pytest.approx(score, abs=0.05), name


@pytest.mark.slow
def test_the_run_says_which_part_it_is(run, long_recording):
    document = json.loads((run.path / "run.json").read_text())
    assert (document["configuration"]["from_tick"], document["configuration"]["to_tick"]) == (FIRST, LAST)
    assert next(d for d in run.plan.decisions if d.about == "part").choice == "ticks 80 to 279"
    assert "200 planes (ticks 80 to 279)" in (run.path / "report.html").read_text()
    shown = sorted(int(file.stem.removeprefix("render_")) for file in (run.path / "thumbnails").glob("render_*.png"))
    assert FIRST <= shown[0] < shown[-1] < LAST
    assert json.loads((run.path / "viewer.json").read_text())["clip_s"] == [FIRST / RATE_HZ, LAST / RATE_HZ]


@pytest.mark.slow
def test_evaluate_and_export_of_a_part_mean_the_ticks_of_the_whole(run, long_recording, spike4dgs, tmp_path):
    scored = spike4dgs("evaluate", run.path, "--truth", long_recording / "truth", "--json")
    assert scored.status == 0, scored.lines
    assert json.loads(scored.out)["psnr_db"] == json.loads((run.path / "metrics.json").read_text())["psnr_db"]
    out = tmp_path / "out"
    few = ("--from-tick", 170, "--to-tick", 200, "--frames", 2, "--out", out)
    made = spike4dgs("export", run.path, "--format", "nerfstudio", *few)
    assert made.status == 0, made.lines
    assert json.loads((out / "manifest.json").read_text())["clip_s"] == [170 / RATE_HZ, 200 / RATE_HZ]
    assert {f.name for f in (out / "images").glob("cam00_*")} == {"cam00_000177.png", "cam00_000192.png"}
    out = tmp_path / "depth"
    early = spike4dgs("export", run.path, "--format", "depth", "--from-tick", 79, "--out", out)
    assert early.refused("ticks from 80 to 280")


@pytest.mark.slow
def test_a_part_is_resumed_as_the_same_part_alone(long_recording, tmp_path):
    path = tmp_path / "run"
    short = replace(PART, from_tick=100, to_tick=160)
    reconstruct(long_recording, path, short, quiet, last="plan")
    for other in (replace(short, to_tick=161), replace(short, from_tick=None, to_tick=None)):
        with pytest.raises(BadRunError, match="another configuration"):
            reconstruct(long_recording, path, other, quiet)
    done = reconstruct(long_recording, path, short, quiet)
    assert not done.plan.spans
    cloud = load_cloud(done.checkpoint)
    assert (cloud.clip.first_s, cloud.clip.last_s) == (100 / RATE_HZ, 160 / RATE_HZ)
    metrics = json.loads((path / "metrics.json").read_text())
    assert metrics["psnr_db"] > metrics["nearest_view.psnr_db"] + 2


def test_too_few_planes_for_a_picture_are_refused(long_recording, tmp_path):
    for count in (1, 2, LEAST_WINDOW - 1):
        few = replace(PART, from_tick=100, to_tick=100 + count)
        with pytest.raises(BadRunError, match=f"found {count} planes, expected at least {LEAST_WINDOW}"):
            reconstruct(long_recording, tmp_path / f"run-{count}", few, quiet)


@pytest.mark.slow
def test_a_part_between_the_instants_of_the_truth_is_scored_by_its_counts(long_recording, tmp_path):
    between = replace(PART, from_tick=101, to_tick=119, steps=8)
    done = reconstruct(long_recording, tmp_path / "run", between, quiet)
    metrics = json.loads((done.path / "metrics.json").read_text())
    assert metrics["counts.mae"] > 0
    assert "no truth" in metrics["note"]


@pytest.mark.parametrize(
    ("ticks", "said"),
    [
        (("--from-tick", 300), "ticks 300 to 300"),
        (("--to-tick", 301), "ticks 0 to 301"),
        (("--from-tick", -1, "--to-tick", 5), "ticks -1 to 5"),
        (("--from-tick", 9, "--to-tick", 9), "ticks 9 to 9"),
        (("--from-tick", 9, "--to-tick", 8), "ticks 9 to 8"),
        (("--from-tick", "1.5"), "'1.5' is not a valid integer"),
    ],
)
@pytest.mark.slow
def test_ticks_that_are_not_there_are_one_line_and_make_nothing(ticks, said, long_recording, spike4dgs, tmp_path):
    assert spike4dgs("reconstruct", long_recording, "--out", tmp_path / "run", *ticks).refused(said)
    assert not (tmp_path / "run").exists()
