"""The sheet of movers: what it enlarges, whose command renders it, and what it shows where a run is missing."""

import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.session.record import simulate
from reconstruction.bench.contact_sheet import TITLE_PX
from reconstruction.bench.conventions import HOLDOUT, KnownRecording
from reconstruction.bench.rivals import sheet as rivals_sheet
from reconstruction.bench.rivals.bench import SHORT
from reconstruction.bench.rivals.sheet import write_rivals_sheet
from reconstruction.bench.speed.mover_sheet import SHARE, ZOOM, most_moving, shoot, write_mover_sheet
from reconstruction.bench.speed.run import OLD, Contender
from reconstruction.errors import ReconstructionError
from rigs.exchange.nerfstudio import load_frames
from rigs.toml import catalog_rig

RENDERS = """
import pathlib, shutil, sys
assert sys.argv[1] == "render" and sys.argv[3] == "--cameras" and sys.argv[5] == "--out"
out = pathlib.Path(sys.argv[6])
out.mkdir()
shutil.copy(sys.argv[4], out.parent.parent / "asked.json")
(out / "000000.npy").write_bytes(b"an image")
"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    path = tmp_path_factory.mktemp("movers") / "rec"
    simulate(Simulation("fan_and_ball", seed=1, truth_every=20), catalog_rig("ci3x3"), 60, path)
    return KnownRecording("fan_and_ball", 1, path)


def contender(path: Path, text: str) -> Contender:
    path.write_text(text)
    return Contender(OLD, (sys.executable, str(path)), Path(sys.executable))


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (7, 11), (40, 64)])
@pytest.mark.parametrize("share", [0.0, 0.05, 1.0])
def test_the_part_with_the_most_moving_pixels_is_enlarged(size, share):
    moving = np.random.default_rng(1).random(size) < share
    rows, columns = most_moving(moving)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    assert (height, width) == tuple(max(1, round(SHARE * one)) for one in size)
    counts = [
        moving[row : row + height, column : column + width].sum()
        for row in range(size[0] - height + 1)
        for column in range(size[1] - width + 1)
    ]
    assert moving[rows, columns].sum() == max(counts)


def test_a_run_is_rendered_by_the_command_that_made_it(clip, tmp_path):
    run, image = tmp_path / "run", tmp_path / "kept" / "image.npy"
    run.mkdir()
    shoot(contender(tmp_path / "renders.py", RENDERS), clip, run, image)
    assert image.read_bytes() == b"an image"
    (frame,) = load_frames(tmp_path / "asked.json")
    planes = clip.truth.planes(HOLDOUT)
    assert frame.camera.id == HOLDOUT
    assert frame.instant_s == pytest.approx(planes[len(planes) // 2] / 20_000, abs=1e-4)


def test_a_command_that_fails_is_told_and_keeps_nothing(clip, tmp_path):
    fails = contender(tmp_path / "fails.py", "raise SystemExit(3)")
    with pytest.raises(ReconstructionError, match="found exit code 3 of render"):
        shoot(fails, clip, tmp_path, tmp_path / "image.npy")
    assert not (tmp_path / "image.npy").exists()


def test_differences_are_of_the_truth_and_a_missing_run_is_black(clip, tmp_path):
    planes = clip.truth.planes(HOLDOUT)
    truth = clip.truth.frame(HOLDOUT, planes[len(planes) // 2])
    np.save(tmp_path / "same.npy", truth.intensity)
    np.save(tmp_path / "dark.npy", 0 * truth.intensity)
    images = {name: tmp_path / f"{name}.npy" for name in ("same", "dark", "missing")}
    write_mover_sheet(tmp_path / "sheet.png", [(clip, images)])
    sheet = cv2.imread(str(tmp_path / "sheet.png"), cv2.IMREAD_GRAYSCALE)
    rows, columns = most_moving(truth.moving)
    height, width = ZOOM * (rows.stop - rows.start), ZOOM * (columns.stop - columns.start)
    above, below = (
        [strip[TITLE_PX : TITLE_PX + height, left : left + width] for left in range(0, sheet.shape[1], width + 4)]
        for strip in np.split(sheet, 2)
    )
    assert np.array_equal(above[0], above[1])
    assert above[0].any()
    assert below[0].any()
    assert below[2].any()
    for black in (above[2], above[3], below[1], below[3]):
        assert not black.any()


def test_the_sheet_of_rivals_has_the_scenes_of_which_all_runs_were_kept(clip, tmp_path, monkeypatch):
    asked = []

    def run_of(cell):
        return SimpleNamespace(snapshots=lambda: [Path("old.pt"), Path(f"{cell.method.name}.pt")])

    class Kept:
        def kept(self, cell):
            return None if cell.scene == "robot_arm" and cell.method.name == "stg" else tmp_path

        def runs(self, cells):
            asked.extend(cells)
            return [(clip, run_of(cell)) for cell in asked]

    def load_cloud(snapshot):
        share = 1.0 if snapshot.stem == "auto" else 0.0
        return SimpleNamespace(look=lambda camera, instant_s: SimpleNamespace(intensity=share * clip.middle.intensity))

    monkeypatch.setattr(rivals_sheet, "load_cloud", load_cloud)
    write_rivals_sheet(tmp_path / "none.png", Kept(), ("robot_arm",))
    assert not (tmp_path / "none.png").exists()
    write_rivals_sheet(tmp_path / "sheet.png", Kept(), ("robot_arm", "fan_and_ball"))
    assert {(cell.scene, cell.effort) for cell in asked} == {("fan_and_ball", SHORT)}
    assert [cell.method.name for cell in asked] == ["auto", "stg", "tfi+stg", "tfi+4dgs"]
    sheet = cv2.imread(str(tmp_path / "sheet.png"), cv2.IMREAD_GRAYSCALE)
    strips = [np.array_split(strip[TITLE_PX:], 5, axis=1) for strip in np.split(sheet, 2)]
    above, below = ([bool(part.any()) for part in strip] for strip in strips)
    assert above == [True, True, False, False, False]  # truth, ours as it is, rivals that are black
    assert below == [True, False, True, True, True]  # the view, no difference, all of it
