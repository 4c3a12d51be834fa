"""A recording in spans from end to end, at 100x64: scored by span, killed between and within its parts, exported."""

import copy
import json
import shutil
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.pipeline import span_artefacts, span_training
from reconstruction.pipeline.budget import Budget, StoppedError
from reconstruction.pipeline.part_file import PartFile
from reconstruction.pipeline.parts_training import PartError, SpanTraining
from reconstruction.pipeline.span_artefacts import BLIND, moving_spans, read_targets
from reconstruction.pipeline.stages import reconstruct, reconstruct_part
from reconstruction.pipeline.trained_scene import trained_scene
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from reconstruction.run.parts import STILL, Failure, PartFolder, span_name
from reconstruction.tensors import packed
from reconstruction.training.averaging import Averages
from reconstruction.training.checkpoint import load_checkpoint, load_cloud

pytestmark = pytest.mark.slow
SPAN, STEPS = 100, 24
CONFIG = ReconstructionConfig(holdout="cam11", steps=STEPS, budget_s=None, seed=1, gaussians=3000, span=SPAN)
HURRIED = replace(CONFIG, steps=None, budget_s=0.01)


def quiet(stage):
    return silent


def hurried(begun: Path, path: Path) -> Path:
    """Copy a run that has begun, as if it had been given next to no time."""
    shutil.copytree(begun, path)
    run = RunFolder.open(path)
    run.document.configuration = HURRIED
    run.save()
    return path


@pytest.fixture(scope="module")
def begun(long_recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "begun"
    reconstruct(long_recording, path, CONFIG, quiet, last="points")
    return path


@pytest.fixture(scope="module")
def run(long_recording, begun, tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "run"
    shutil.copytree(begun, path)
    return reconstruct(long_recording, path, CONFIG, quiet)


def test_a_span_that_is_learnt_leaves_no_images_in_memory(long_recording, begun, tmp_path, monkeypatch):
    shutil.copytree(begun, tmp_path / "run")
    seen, read = [], span_training.read_span_views

    def noted(*given):
        views = read(*given)
        seen.extend(weakref.ref(view.source) for view in views.values())
        return views

    monkeypatch.setattr(span_training, "read_span_views", noted)
    for part in (STILL, span_name(1)):
        reconstruct_part(long_recording, tmp_path / "run", CONFIG, part, silent)
    assert len(seen) == 8
    assert not [ref for ref in seen if ref() is not None]


def test_a_span_keeps_what_its_training_ends_with(run, long_recording, monkeypatch):
    """Bodies that are joined are another cloud than the one that began."""
    ends, train = [], span_training.train

    def joining(trainer, done, on_step):
        train(trainer, done, on_step)
        trainer.cloud, trainer.averages = copy.deepcopy(trainer.cloud), Averages()
        trainer.cloud.moving.means.data += 1.0
        ends.append(trainer.cloud.moving.means)

    monkeypatch.setattr(span_training, "train", joining)
    still = load_cloud(run.checkpoint).still
    recording = Recording.open(long_recording)
    content = span_training.learn_span(run, recording, 1, still, lambda steps: steps / 2, lambda *_: None)
    assert content.cloud is not None
    assert torch.equal(content.cloud.moving.means, ends[0])


def test_every_span_is_scored_and_the_whole_beats_the_nearest_view(run):
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert [(row["first_tick"], row["last_tick"]) for row in metrics["spans"]] == [(0, 99), (100, 199), (200, 299)]
    for row in metrics["spans"]:
        assert row["psnr_db"] > metrics["nearest_view.psnr_db"] + 2
        assert row["seconds"] > 0
        assert {"dynamic_psnr_db", "abs_rel"} <= set(row)
    document = json.loads((run.path / "run.json").read_text())
    assert document["status"] == "finished"
    assert document["steps"] == 4 * STEPS
    assert next(d for d in run.plan.decisions if d.about == "spans").facts["spans"] == 3


def test_the_curve_begins_with_the_still_scene_and_ends_with_all_spans(run):
    rows = json.loads((run.path / "error_vs_time.json").read_text())["rows"]
    assert rows[0]["steps"] == STEPS
    assert rows[-1]["steps"] == 4 * STEPS
    assert rows[-1]["dynamic_psnr_db"] > rows[0]["dynamic_psnr_db"]


def test_images_of_any_plane_show_the_movers(run, long_recording):
    opened = Recording.open(long_recording)
    for _, source in read_targets(run, opened).values():
        image = source.at(150)
        count = source.stream.counts(142, 159) / 17
        assert np.abs(image - count).mean() < 0.03


def test_a_span_holds_the_mask_of_no_other(run, long_recording):
    views = span_artefacts.read_span_views(run, Recording.open(long_recording), 1, run.plan.spans[1])
    for moving in (view.source.moving for view in views.values()):
        whole = moving if moving.base is None else moving.base
        assert whole.nbytes == moving.nbytes == 64 * 100


def test_a_span_whose_images_two_threads_want_at_once_is_read_once(run, long_recording, monkeypatch):
    read, numbers = span_artefacts.read_span_views, []

    def slowly(*given):
        numbers.append(given[2])
        time.sleep(0.05)
        return read(*given)

    monkeypatch.setattr(span_artefacts, "read_span_views", slowly)
    targets = read_targets(run, Recording.open(long_recording))
    with ThreadPoolExecutor(4) as pool:
        images = list(pool.map(lambda seen: seen[1].at(150), targets.values()))
    assert numbers == [1]
    assert len(images) == 8


def test_formats_show_the_span_of_their_instant(run, tmp_path):
    scene = trained_scene(run)
    for at_s in (0.0025, 0.0125):
        file = tmp_path / f"{at_s}.ply"
        export_scene(scene, "ply", file, Choices(at_s=at_s))
        assert file.stat().st_size > 1000
    assert (tmp_path / "0.0025.ply").read_bytes() != (tmp_path / "0.0125.ply").read_bytes()


@pytest.mark.parametrize("kills", [pytest.param((0,), marks=pytest.mark.long), (STEPS - 1, STEPS + 3, STEPS + 1)])
def test_killed_within_a_part_it_ends_in_the_same_scene(kills, run, long_recording, begun, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(begun, path)
    for steps in kills:
        left = iter([False] * steps + [True] * 10**6)
        with pytest.raises(StoppedError, match=r"stopped in (still|span)"):
            reconstruct(long_recording, path, CONFIG, quiet, stage="train", should_stop=lambda left=left: next(left))
    again = reconstruct(long_recording, path, CONFIG, quiet, stage="train")
    for (name, a), (_, b) in zip(
        load_cloud(run.checkpoint).tensors(), load_cloud(again.checkpoint).tensors(), strict=True
    ):
        assert torch.equal(a, b), name


def test_what_is_learnt_is_not_learnt_again_unless_it_is_asked_for(run, long_recording, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(run.path, path)
    files = [PartFolder(path).file(name) for name in (STILL, span_name(1))]
    before = [file.stat().st_mtime_ns for file in files]
    again = reconstruct(long_recording, path, CONFIG, quiet, stage="train", again=1)
    assert all(file.stat().st_mtime_ns > then for file, then in zip(files, before, strict=True))
    assert isinstance(load_cloud(again.checkpoint), SpannedScene)


def test_a_span_in_the_dark_is_left_out(run, begun, long_recording, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(begun, path)
    dark = RunFolder.open(path)
    for view in dark.plan.views:
        dark.write_array(BLIND.format(view=view), np.array([False, True, False]))
    assert list(moving_spans(RunFolder.open(run.path))) == [0, 1, 2]
    assert list(moving_spans(dark)) == [0, 2]
    done = reconstruct(long_recording, path, CONFIG, quiet, stage="train")
    scene = load_cloud(done.checkpoint)
    assert isinstance(scene, SpannedScene)
    assert scene.spans[1].cloud is None
    assert any(d.about == "spans at rest" for d in done.plan.decisions)


def test_a_budget_that_is_over_is_a_warning(long_recording, begun, tmp_path):
    path = hurried(begun, tmp_path / "run")
    done = reconstruct(long_recording, path, HURRIED, quiet, stage="train")
    assert "was over before training began" in done.document.warnings["train"]
    assert len(load_cloud(done.checkpoint).moving) > 0


def command(long_recording, run, *options):
    """The command line of the configuration of these tests."""
    asked = ["--holdout", "cam11", "--steps", STEPS, "--seed", 1, "--span", SPAN]
    return ["reconstruct", long_recording, "--out", run, *asked, "--stage", "train", *options]


@pytest.fixture
def planned(begun, tmp_path):
    """A run that is ready to be trained by the command line, which has no cap of Gaussians."""
    path = tmp_path / "run"
    shutil.copytree(begun, path)
    document = json.loads((path / "run.json").read_text())
    document["configuration"]["gaussians"] = None
    (path / "run.json").write_text(json.dumps(document))
    return path


def test_parts_that_processes_share_make_the_same_scene_to_the_bit(run, planned, long_recording, spike4dgs):
    path = planned
    before = (path / "run.json").read_bytes()
    for name in ("still", "2", "000000"):
        assert spike4dgs(*command(long_recording, path, "--part", name))[0] == 0
    status, _, lines = spike4dgs(*command(long_recording, path, "--part", "2"))
    assert status == 0
    assert lines[-1] == "part 000002: it was there already; what this process has learnt is dropped"
    assert (path / "run.json").read_bytes() == before
    assert PartFolder(path).there() == {"still", "000000", "000002"}
    assert (path / "preview.png").exists()
    assert spike4dgs(*command(long_recording, path))[0] == 0
    again = RunFolder.open(path)
    for (name, a), (_, b) in zip(
        load_cloud(run.checkpoint).tensors(), load_cloud(again.checkpoint).tensors(), strict=True
    ):
        assert torch.equal(a, b), name
    assert again.document.seconds["train"] > 0
    assert spike4dgs(*command(long_recording, path, "--part", "2"))[0] == 0  # the stage is finished: nothing to do


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--part", "7"], "found the part 000007, expected one that is learnt: still, 000000, 000001, 000002"),
        (["--part", "x"], "found --part 'x', expected still or the number of a span"),
        (["--part", "1"], "found no part still, which 000001 begins with; run --part still first"),
    ],
)
def test_a_part_that_cannot_be_learnt_is_refused(options, said, planned, long_recording, spike4dgs):
    status, _, lines = spike4dgs(*command(long_recording, planned, *options))
    assert status == 2
    assert said in lines[-1]


def test_a_span_that_was_given_up_is_left_out_with_a_warning(begun, long_recording, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(begun, path)
    PartFolder(path).give_up(span_name(1), Failure("found a fault", 3))
    done = reconstruct(long_recording, path, CONFIG, quiet, stage="train")
    scene = load_cloud(done.checkpoint)
    assert isinstance(scene, SpannedScene)
    assert [span.cloud is None for span in scene.spans] == [False, True, False]
    said = "spans 1 were given up and show the still scene alone; the first after 3 tries: found a fault"
    assert done.document.warnings["train"] == said
    assert not any(d.about == "spans at rest" for d in done.plan.decisions)
    done = reconstruct(long_recording, path, CONFIG, quiet, stage="train", again=1)
    assert "train" not in done.document.warnings


def test_without_its_still_scene_a_run_fails(begun, long_recording, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(begun, path)
    PartFolder(path).give_up(STILL, Failure("found the dark", 1, bad_input=True))
    with pytest.raises(PartError, match="found the still scene given up after 1 tries: found the dark") as raised:
        reconstruct(long_recording, path, CONFIG, quiet, stage="train")
    assert raised.value.bad_input


def test_each_part_has_seconds_of_its_own_whenever_it_begins(begun, long_recording):
    now = [100.0]
    run = RunFolder.open(begun)
    run.document.seconds = dict.fromkeys(run.document.seconds, 0.5)  # of four stages
    budget = Budget(lambda: now[0], 0.0, 0.0, 11.0, None)
    training = SpanTraining(run, Recording.open(long_recording), silent, budget, lambda: False)
    own = {part.name: 2.0 * part.weight for part in training.parts}  # of 9 s, by 1.5 and three spans of 1 in the mean
    assert own[STILL] == 3.0
    for name in (STILL, "000000", "000002"):
        done, own_s = training.done_of(name), own[name]
        found = []
        for _ in range(4):
            found.append(done(0))
            now[0] += own_s / 2
        assert found == pytest.approx([0.0, 0.5, 1.0, 1.0])


def test_parts_that_are_learnt_at_once_have_as_many_times_their_seconds(begun, long_recording):
    now = [0.0]
    run = RunFolder.open(begun)
    run.document.seconds = dict.fromkeys(run.document.seconds, 0.5)
    budget = Budget(lambda: now[0], 0.0, 0.0, 11.0, None)
    training = SpanTraining(run, Recording.open(long_recording), silent, budget, lambda: False)
    done = training.done_of("000000", beside=2)
    now[0] = next(2.0 * part.weight for part in training.parts if part.name == "000000")
    assert done(0) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("threads", "there", "at_once"), [(2, [], [2, 2, 1]), (1, [], [1, 1, 1]), (4, ["000000"], [2, 2])]
)
def test_spans_are_learnt_side_by_side_and_what_is_left_over_alone(
    threads, there, at_once, begun, long_recording, tmp_path, monkeypatch
):
    path = hurried(begun, tmp_path / "run")
    for name in (STILL, *there):
        reconstruct_part(long_recording, path, HURRIED, name, silent)
    budget, told = Budget(time.monotonic, 0.0, 0.0, None, STEPS), []
    training = SpanTraining(
        RunFolder.open(path), Recording.open(long_recording), lambda *said: told.append(said[0]), budget, lambda: False
    )
    still, found, before = training.still(), [], torch.get_num_threads()
    monkeypatch.setattr(training, "done_of", lambda name, beside: found.append(beside) or budget.done)
    torch.set_num_threads(threads)
    try:
        names = [one.name for one in training.parts[1:]]
        spans = list(training.spans(names, still))
    finally:
        torch.set_num_threads(before)
    assert [name for name, _, _ in spans] == names
    assert [name for name, _, is_new in spans if not is_new] == there
    assert found == at_once
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0)


def test_seconds_of_a_part_that_was_learnt_elsewhere_are_the_stages_own(begun, long_recording, tmp_path):
    path = hurried(begun, tmp_path / "run")
    assert reconstruct_part(long_recording, path, HURRIED, STILL, silent)
    kept = PartFile(PartFolder(path), STILL)
    kept.folder.file(STILL).write_bytes(packed({**kept.read(), "seconds": 1000.0}))
    done = reconstruct(long_recording, path, HURRIED, quiet, stage="train")
    assert sorted(load_checkpoint(done.checkpoint)["seconds"]) == ["span 0", "span 1", "span 2", "still"]
    assert done.document.seconds["train"] > 1000
