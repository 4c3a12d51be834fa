"""Long recordings of which parts are dark, lost or cut off, in spans of 100x64: the others are learnt as usual."""

import json
import shutil
import warnings

import numpy as np
import pytest
import torch

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.pipeline.artefacts import read_light
from reconstruction.pipeline.span_artefacts import BLIND, moving_spans, read_targets
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.training.checkpoint import load_cloud
from rigs.toml import catalog_rig

pytestmark = pytest.mark.slow
PLANES, SPAN = 400, 100
CONFIG = ReconstructionConfig(holdout="cam11", steps=40, budget_s=None, seed=1, gaussians=3000, span=SPAN)
TRAINED = [f"cam{row}{column}" for row in range(3) for column in range(3) if (row, column) != (1, 1)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "rec"
    simulate(Simulation("fan_and_ball", seed=3), catalog_rig("ci3x3"), PLANES, path)
    return path


def changed(recording, path, lost, value=0):
    """Copy a recording; cameras that are `lost` from their first plane to the end see nothing, or nothing but light."""
    shutil.copytree(recording, path)
    plane_bytes = Recording.open(path).manifest.cameras[0].layout.plane_bytes
    for cameras, first, end in lost:
        for camera_id in cameras:
            np.memmap(path / f"{camera_id}.dat", np.uint8, "r+").reshape(-1, plane_bytes)[first:end] = value
    return path


def learnt(path, out):
    """Reconstruct; no sum is of nothing and no number is divided by nothing on the way."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = reconstruct(path, out, CONFIG, lambda stage: silent)
    cloud = load_cloud(run.checkpoint)
    assert isinstance(cloud, SpannedScene)
    assert all(torch.isfinite(tensor).all() for _, tensor in cloud.tensors() if tensor.is_floating_point())
    metrics = json.loads((run.path / "metrics.json").read_text())
    return run, [row["psnr_db"] for row in metrics["spans"]]


@pytest.fixture(scope="module")
def usual(recording, tmp_path_factory):
    return learnt(recording, tmp_path_factory.mktemp("runs") / "usual")[1]


@pytest.mark.parametrize(
    "lost",
    [
        [(["cam00"], 100, 300), (["cam10"], 300, 400)],
        [(["cam00", "cam01", "cam02"], 100, 200)],
        pytest.param([(["cam22"], 0, 200)], marks=pytest.mark.long),
    ],
)
def test_cameras_that_drop_out_and_return_are_missed_in_those_spans_alone(lost, recording, usual, tmp_path):
    run, scores = learnt(changed(recording, tmp_path / "rec", lost), tmp_path / "run")
    assert not read_light(run).flickers  # what one camera no longer sees is not the light of all
    for view in run.plan.views:
        blind = [any(view in ids and first <= number * SPAN < end for ids, first, end in lost) for number in range(4)]
        assert run.read_array(BLIND.format(view=view)).tolist() == blind
    assert list(moving_spans(run)) == [0, 1, 2, 3]
    assert min(np.array(scores) - usual) > -1.5
    for view, (_, source) in read_targets(run, Recording.open(run.recording)).items():
        for _, first, end in lost:
            assert np.isfinite(source.at((first + end) // 2)).all(), view


@pytest.mark.parametrize(
    ("off", "dark", "lit"),
    [([(100, 200)], [1], [0, 2, 3]), ([(200, 400)], [2, 3], [0, 1]), ([(0, 100), (150, 250)], [0], [3])],
)
def test_light_that_goes_out_is_dark_in_those_spans_alone(off, dark, lit, recording, usual, tmp_path):
    ids = [*TRAINED, "cam11"]
    run, scores = learnt(changed(recording, tmp_path / "rec", [(ids, *planes) for planes in off]), tmp_path / "run")
    gains, shines = read_light(run).gains, np.ones(PLANES, bool)
    for first, end in off:
        assert gains[first + 4 : end - 4].max() < 0.05
        shines[max(0, first - 4) : end + 4] = False
    assert gains[shines].min() > 1
    assert list(moving_spans(run)) == [number for number in range(4) if number not in dark]
    for number in lit:
        assert scores[number] > usual[number] - 4.5


def test_a_span_that_only_one_camera_sees_is_not_learnt(recording, usual, tmp_path):
    run, scores = learnt(changed(recording, tmp_path / "rec", [(TRAINED[1:], 200, 300)]), tmp_path / "run")
    assert list(moving_spans(run)) == [0, 1, 3]
    assert scores[0] > usual[0] - 1.5
    assert scores[1] > usual[1] - 1.5


def test_a_camera_in_the_sun_for_a_span_spoils_no_other(recording, usual, tmp_path):
    _, scores = learnt(changed(recording, tmp_path / "rec", [(["cam00"], 100, 200)], value=0xFF), tmp_path / "run")
    for number in (0, 2, 3):
        assert scores[number] > usual[number] - 1.5


@pytest.mark.parametrize("short", ["cam00", pytest.param("cam22", marks=pytest.mark.long)])
def test_of_a_recording_that_was_cut_off_all_have_the_planes_of_the_shortest(short, recording, tmp_path):
    opened, dats = Recording.open(recording), []
    for camera_id in opened.camera_ids:
        planes = opened.stream(camera_id).window(0, 230 if camera_id == short else PLANES)
        (tmp_path / f"{camera_id}.dat").write_bytes(planes.tobytes())
        dats.append(f"{camera_id}={tmp_path / camera_id}.dat")
    import_recording(dats, recording / "rig.toml", tmp_path / "rec", ImportOptions(20000.0))
    run, _ = learnt_without_truth(tmp_path)
    assert [(span.first, span.last) for span in run.plan.spans] == [(0, 76), (76, 153), (153, 230)]
    assert len(read_light(run).gains) == 230
    assert next(d for d in run.plan.decisions if d.about == "part").choice == "ticks 0 to 229"


def learnt_without_truth(folder):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = reconstruct(folder / "rec", folder / "run", CONFIG, lambda stage: silent)
    return run, json.loads((run.path / "metrics.json").read_text())
