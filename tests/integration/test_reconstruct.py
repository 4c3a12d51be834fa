"""Recording to report at 100x64: the stages, resuming, refusing, and that the held-out camera stays unread."""

import json
import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from click.testing import CliRunner

from acquisition.devices.open import Simulation
from acquisition.durable import write_durably
from acquisition.progress import silent
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.recording.manifest import MANIFEST_FILE, Gap, dump_manifest
from acquisition.recording.reader import Recording, read_manifest
from acquisition.session.record import simulate
from reconstruction.errors import BadRunError, StereoError
from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices
from reconstruction.initialization.points import Points
from reconstruction.pipeline import artefacts, found_bodies, points_stage
from reconstruction.pipeline.artefacts import read_white, recording_of
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.stages import reconstruct
from reconstruction.pipeline.trained_scene import trained_scene
from reconstruction.report.display import grey
from reconstruction.run.configuration import STAGES, ReconstructionConfig
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_checkpoint, load_cloud
from rigs.exchange.nerfstudio import Frame, dump_frames
from rigs.toml import catalog_rig
from server.cli.reconstruct import render_command

pytestmark = pytest.mark.slow
CONFIG = ReconstructionConfig(holdout="cam11", steps=60, budget_s=None, seed=1, gaussians=3000)
OUTER = ("cam00", "cam01", "cam02", "cam10", "cam12", "cam20", "cam21", "cam22")


def quiet(stage):
    return silent


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "rec"
    simulate(Simulation("fan_and_ball", seed=3), catalog_rig("ci3x3"), 120, path)
    return path


@pytest.fixture(scope="module")
def run(recording, tmp_path_factory):
    return reconstruct(recording, tmp_path_factory.mktemp("runs") / "run", CONFIG, quiet)


def test_it_beats_the_nearest_view_and_writes_every_artefact(run):
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert metrics["psnr_db"] > metrics["nearest_view.psnr_db"] + 3
    assert metrics["abs_rel"] < 0.15
    written = ("run.json", "error_vs_time.json", "error_vs_time.png", "report.html", "orbit.mp4", "checkpoint.pt")
    for name in (*written, "viewer.json", "viewer.bin", "evidence.pt"):
        assert (run.path / name).stat().st_size > 0
    document = json.loads((run.path / "run.json").read_text())
    assert document["status"] == "finished"
    assert set(document["seconds"]) == set(STAGES)
    assert document["plan"]["model"] in ("bases", "linear")


def test_render_writes_the_error_to_expect_beside_each_picture(run, tmp_path):
    metrics = json.loads((run.path / "metrics.json").read_text())
    assert metrics["expected_error.ratio"] > 0
    assert -1 <= metrics["expected_error.rank"] <= 1
    frame = Frame(Recording.open(run.recording).rig.camera("cam11"), 0.003)
    (tmp_path / "t.json").write_text(dump_frames([frame], ["a.png"]))
    words = [run.path, "--cameras", tmp_path / "t.json", "--out", tmp_path / "out"]
    done = CliRunner().invoke(render_command, list(map(str, words)))
    assert done.exit_code == 0, done.output
    light, expected = (np.load(tmp_path / "out" / f"{name}000000.npy") for name in ("", "sd_"))
    assert expected.shape == light.shape
    assert expected.dtype == np.float32
    assert np.isfinite(expected).all()
    assert (expected > 0).mean() > 0.9


def test_the_curve_rises_with_time(run):
    rows = json.loads((run.path / "error_vs_time.json").read_text())["rows"]
    assert rows[-1]["steps"] == 60
    assert [r["seconds"] for r in rows] == sorted(r["seconds"] for r in rows)
    assert rows[-1]["psnr_db"] > rows[0]["psnr_db"]


def test_the_training_has_shown_what_it_learnt(run):
    assert json.loads((run.path / "preview.json").read_text()) == {"camera": CONFIG.holdout, "steps": 60}
    cloud, recording = load_cloud(run.checkpoint), Recording.open(run.recording)
    seen = cloud.look(recording.rig.camera(CONFIG.holdout), cloud.clip.middle_s).intensity
    shown = cv2.imread(str(run.path / "preview.png"), cv2.IMREAD_GRAYSCALE)
    assert np.abs(shown.astype(int) - grey(seen, read_white(run))).max() <= 1


def killed_at(function, call):
    """Return the function, which a kill ends at that call of it."""
    calls = iter(range(1, call + 1))

    def called(*given):
        if next(calls) == call:
            raise KeyboardInterrupt
        return function(*given)

    return called


def test_movers_that_ride_on_nothing_are_swept_as_often_as_straight_paths_want(recording, tmp_path, monkeypatch):
    choose = found_bodies.choose_bodies

    def none_of(*given):
        found = choose(*given)
        return found._replace(bodies=found.bodies.only(np.zeros(0, np.int64)))

    monkeypatch.setattr(found_bodies, "choose_bodies", none_of)
    run = reconstruct(recording, tmp_path / "run", CONFIG, quiet, last="points")
    assert (run.document.planned.sweeps, run.plan.model, run.plan.sweeps) == (4, "linear", 8)
    moving = artefacts.read(run, artefacts.MOVERS, Points)
    assert len(np.unique(moving.instants_s)) == 8
    monkeypatch.setattr(points_stage, "_swept", killed_at(points_stage._swept, 3))
    with pytest.raises(KeyboardInterrupt):
        reconstruct(recording, tmp_path / "killed", CONFIG, quiet, last="points")
    monkeypatch.undo()
    monkeypatch.setattr(found_bodies, "choose_bodies", none_of)
    resumed = reconstruct(recording, tmp_path / "killed", CONFIG, quiet, last="points")
    np.testing.assert_array_equal(artefacts.read(resumed, artefacts.MOVERS, Points).positions, moving.positions)


def test_the_report_stands_alone(run):
    page = (run.path / "report.html").read_text()
    assert "data:image/png;base64," in page
    assert 'src="http' not in page
    assert "depth-warped blend" in page


def test_a_finished_run_is_refused_and_unchanged(run, recording):
    before = (run.path / "metrics.json").read_bytes()
    with pytest.raises(BadRunError, match="finished run"):
        reconstruct(recording, run.path, CONFIG, quiet)
    assert (run.path / "metrics.json").read_bytes() == before


def test_depth_shows_parallax(run, recording):
    """Two outer cameras see near things shifted against far ones by what the rendered depth says."""
    cloud, rig = load_cloud(run.checkpoint), Recording.open(recording).rig
    centre = cloud.look(rig.camera("cam11"), 0.003)
    known = centre.depth[np.isfinite(centre.depth)]
    assert known.size > 0.8 * centre.depth.size
    near, far = np.percentile(known, [5, 95])
    assert far / near > 1.5


def test_a_training_killed_and_resumed_ends_in_the_same_state(run, recording, tmp_path):
    calls = iter(range(10**6))
    for stage in STAGES[:4]:
        reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage=stage)
    with pytest.raises(StoppedError, match="stopped at step 31"):
        reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage="train", should_stop=lambda: next(calls) == 30)
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["trainer"]["steps"] == 31
    resumed = reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage="train")
    for (name, a), (_, b) in zip(
        load_cloud(run.checkpoint).tensors(), load_cloud(resumed.checkpoint).tensors(), strict=True
    ):
        assert torch.equal(a, b), name


@pytest.mark.parametrize(("model", "kind"), [("spikenerf", 0), pytest.param("dy-spikenerf", 1, marks=pytest.mark.long)])
def test_a_radiance_field_trains_resumes_is_scored_and_exports_what_it_can(model, kind, recording, tmp_path):
    config = replace(CONFIG, model=model, steps=6)
    whole = reconstruct(recording, tmp_path / "whole", config, quiet)
    calls = iter(range(10**6))
    for stage in STAGES[:4]:
        reconstruct(recording, tmp_path / "run", config, quiet, stage=stage)
    with pytest.raises(StoppedError, match="stopped at step 3"):
        reconstruct(recording, tmp_path / "run", config, quiet, stage="train", should_stop=lambda: next(calls) == 2)
    resumed = reconstruct(recording, tmp_path / "run", config, quiet, stage="train")
    fields = [load_cloud(run.checkpoint) for run in (whole, resumed)]
    for (name, a), (_, b) in zip(*(field.tensors() for field in fields), strict=True):
        assert torch.equal(a, b), name
    assert (len(fields[0].moving) > 0) == bool(kind)
    metrics = json.loads((whole.path / "metrics.json").read_text())
    assert metrics["psnr_db"] > metrics["nearest_view.psnr_db"]
    assert not (whole.path / "viewer.json").exists()
    with pytest.raises(BadRunError, match="expected Gaussians"):
        export_scene(trained_scene(whole), "ply", tmp_path / "scene.ply", Choices())


@pytest.mark.parametrize("choice", [{"refine": "on"}, {"supervision": "counts"}])
def test_a_radiance_field_refuses_what_it_cannot_do(choice, recording, tmp_path):
    with pytest.raises(BadRunError, match="--model spikenerf"):
        reconstruct(recording, tmp_path / "run", replace(CONFIG, model="spikenerf", **choice), quiet, stage="plan")


@pytest.mark.parametrize("model", ["bases", "4dgs", pytest.param("stg", marks=pytest.mark.long), "d3dgs", "dy-spikegs"])
def test_every_model_trains_from_its_own_points_and_resumes(model, recording, tmp_path):
    config = replace(CONFIG, model=model, steps=12)
    calls = iter(range(10**6))
    for stage in STAGES[:4]:
        run = reconstruct(recording, tmp_path / "run", config, quiet, stage=stage)
    with pytest.raises(StoppedError, match="stopped at step 6"):
        reconstruct(recording, tmp_path / "run", config, quiet, stage="train", should_stop=lambda: next(calls) == 5)
    run = reconstruct(recording, tmp_path / "run", config, quiet, stage="train")
    cloud = load_cloud(run.checkpoint)
    assert cloud.motion.kind == {"dy-spikegs": "4dgs"}.get(model, model)
    assert len(cloud.moving) > 20
    if model == "bases":
        found = run.document.bodies
        assert found is not None
        assert found.attached + sum(found.free.values()) == len(cloud.moving)


def test_a_stage_before_its_predecessor_is_refused(recording, tmp_path):
    with pytest.raises(BadRunError, match="no finished stage plan"):
        reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage="train")


def test_the_held_out_camera_is_not_read_before_the_report(recording, tmp_path, monkeypatch):
    read = []
    stream = Recording.stream
    monkeypatch.setattr(Recording, "stream", lambda self, c: (read.append(c), stream(self, c))[1])
    for stage in STAGES[:5]:
        reconstruct(recording, tmp_path / "run", CONFIG, quiet, stage=stage)
    assert "cam11" not in read
    assert "cam00" in read


def test_poses_that_do_not_belong_to_the_recording_stop_with_the_reason(recording, tmp_path):
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    for file in recording.glob("*.dat"):
        (wrong / file.name).symlink_to(file)
    (wrong / "recording.json").write_text((recording / "recording.json").read_text())
    shuffled = dict(zip(OUTER, [OUTER[i] for i in (2, 4, 3, 6, 5, 0, 1, 7)], strict=True))
    rig = re.sub(r"cam\d\d", lambda m: shuffled.get(m[0], m[0]), (recording / "rig.toml").read_text())
    (wrong / "rig.toml").write_text(rig)
    with pytest.raises(StereoError, match="check the poses"):
        reconstruct(wrong, tmp_path / "run", CONFIG, quiet)


def test_a_budget_that_was_over_before_training_is_a_warning(recording, tmp_path):
    run = reconstruct(recording, tmp_path / "run", replace(CONFIG, budget_s=0.01, steps=None), quiet)
    (warning,) = RunFolder.open(run.path).document.warnings.values()
    assert warning.startswith("the budget of 0.01 s was over before training began, after ")
    assert warning in (run.path / "report.html").read_text()
    run.forget(["train", "report"], attempt=1)
    assert RunFolder.open(run.path).document.warnings == {}


def test_a_run_whose_budget_reached_training_has_no_warning(run):
    assert run.document.warnings == {}
    assert 'class="warning"' not in (run.path / "report.html").read_text()


def held(path):
    return {file: file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file() and file.name != ".lock"}


def test_a_refused_repetition_leaves_a_finished_run_as_it_was(run, recording):
    before = held(run.path)
    with pytest.raises(BadRunError, match="another configuration"):
        reconstruct(recording, run.path, replace(CONFIG, steps=61), quiet, stage="train", again=1)
    with run.locked(), pytest.raises(BadRunError, match="another process"):
        reconstruct(recording, run.path, CONFIG, quiet, stage="train", again=1)
    with pytest.raises(BadRunError, match=r"no readable run\.json"):
        reconstruct(recording, run.path / "nothing", CONFIG, quiet, stage="train", again=1)
    assert held(run.path) == before


def test_a_training_that_was_killed_after_its_last_step_makes_no_other(run, recording, tmp_path):
    shutil.copytree(run.path, tmp_path / "run")
    cut = RunFolder.open(tmp_path / "run")
    cut.document.status = "unfinished"
    del cut.document.seconds["train"], cut.document.seconds["report"]
    cut.save()
    resumed = reconstruct(recording, cut.path, CONFIG, quiet, last="train")
    assert resumed.document.steps == 60
    assert [file.name for file in resumed.snapshots()] == [file.name for file in run.snapshots()]
    one, other = load_cloud(run.checkpoint), load_cloud(resumed.checkpoint)
    assert torch.equal(one.still.means, other.still.means)


def test_a_camera_that_was_cut_off_costs_the_others_nothing_where_it_is_left_out(recording, tmp_path):
    for file in recording.glob("*.dat"):
        data = file.read_bytes()
        (tmp_path / file.name).write_bytes(data[: len(data) // 4] if file.stem == "cam12" else data)
    short, rig = tmp_path / "short", Recording.open(recording).rig
    dats = [f"{camera_id}={tmp_path / camera_id}.dat" for camera_id in rig.ids]
    import_recording(dats, recording / "rig.toml", short, ImportOptions(rig.tick_rate_hz))
    views = replace(CONFIG, views=("cam00", "cam01", "cam02"))
    run = reconstruct(short, tmp_path / "views", views, quiet, last="plan")
    assert (run.plan.decisions[0].choice, run.document.warnings) == ("ticks 0 to 119", {})
    assert recording_of(run).planes == 120
    manifest = read_manifest(short)
    gaps = {"cam01": (Gap(40, 25, "link"),)}
    cameras = tuple(replace(one, gaps=gaps.get(one.id, ())) for one in manifest.cameras)
    write_durably(short / MANIFEST_FILE, dump_manifest(replace(manifest, cameras=cameras)))
    gapped = reconstruct(short, tmp_path / "gapped", replace(views, from_tick=50), quiet, last="plan")
    assert gapped.document.warnings["plan"].startswith("planes were lost, 15 of cam01, and count as darkness: ")
    later = reconstruct(short, tmp_path / "later", replace(views, from_tick=65), quiet, last="plan")
    assert later.document.warnings == {}
    all_of_them = reconstruct(short, tmp_path / "all", CONFIG, quiet, last="plan")
    assert all_of_them.plan.decisions[0].choice == "ticks 0 to 29"
    assert all_of_them.document.warnings["plan"].startswith("cam12 ends at tick 29, where others go on to tick 119: ")
