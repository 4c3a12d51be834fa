"""Tests where an export may go, its refusals, and that nothing half-written ever has a final name."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import pytest

from acquisition.durable import made_aside
from acquisition.errors import DiskError
from reconstruction.errors import BadRunError
from reconstruction.export import catalogue
from reconstruction.export.catalogue import FORMATS, export_scene
from reconstruction.export.scene import Choices
from reconstruction.pipeline.trained_scene import trained_scene
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from rigs.errors import RigError


def names(folder):
    return sorted(f.name for f in folder.iterdir())


@pytest.mark.parametrize("name", sorted(set(FORMATS) - {"nerfstudio"}))
def test_every_format_replaces_its_own_only_when_asked(name, one_scene, tmp_path):
    path = tmp_path / "there"
    takes = FORMATS[name].takes
    choices = Choices(frames=2 if "frames" in takes else None)
    export_scene(one_scene, name, path, choices)
    before = path.stat().st_mtime_ns
    with pytest.raises(BadRunError, match=r"there: found something there, .* --overwrite"):
        export_scene(one_scene, name, path, choices)
    assert path.stat().st_mtime_ns == before
    export_scene(one_scene, name, path, choices, overwrite=True)
    assert path.stat().st_mtime_ns != before
    assert names(tmp_path) == ["there"]


def test_a_folder_that_no_export_made_is_never_replaced(one_scene, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("x")
    with pytest.raises(BadRunError, match="no export made"):
        export_scene(one_scene, "colmap", tmp_path / "home", Choices(), overwrite=True)
    (tmp_path / "home" / "manifest.json").write_text('{"name": "a web page"}')
    with pytest.raises(BadRunError, match="no export made"):
        export_scene(one_scene, "colmap", tmp_path / "home", Choices(), overwrite=True)
    assert (tmp_path / "home" / "thesis.tex").read_text() == "x"


def test_an_empty_folder_may_be_filled_and_parents_are_made(one_scene, tmp_path):
    (tmp_path / "empty").mkdir()
    export_scene(one_scene, "colmap", tmp_path / "empty", Choices())
    export_scene(one_scene, "ply", tmp_path / "a" / "b" / "scene.ply", Choices())
    assert json.loads((tmp_path / "empty" / "manifest.json").read_text())["format"] == "colmap"
    assert (tmp_path / "a" / "b" / "scene.ply").exists()


def test_the_folder_one_stands_in_may_be_filled(one_scene, tmp_path, monkeypatch):
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    export_scene(one_scene, "viewer", Path(), Choices())
    assert "viewer.bin" in names(tmp_path / "empty")
    assert names(tmp_path) == ["empty"]


def test_a_parent_that_is_a_file_is_one_line(one_scene, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(DiskError, match="cannot be written"):
        export_scene(one_scene, "ply", tmp_path / "file" / "scene.ply", Choices())


def test_files_and_folders_do_not_take_each_others_place(one_scene, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(BadRunError, match="found a file, expected the name of a folder"):
        export_scene(one_scene, "depth", tmp_path / "file", Choices(), overwrite=True)
    with pytest.raises(BadRunError, match="found a folder, expected the name of a file"):
        export_scene(one_scene, "ply", tmp_path, Choices(), overwrite=True)


@pytest.mark.parametrize(
    ("name", "choices", "message"),
    [
        ("obj", Choices(), r"'obj', expected one of colmap, depth, glb, nerfstudio, ply"),
        ("ply", Choices(at_s=0.5), r"0\.5 s, expected one within the clip, 0\.002 to 0\.012 s"),
        ("ply", Choices(at_s=float("nan")), "expected one within the clip"),
        ("ply", Choices(frames=3), "--frames for ply, which takes --at"),
        ("video", Choices(at_s=0.005), "--at for video, which takes --frames, --camera, --from-tick, --to-tick"),
        ("viewer", Choices(camera="cam00"), "--camera for viewer, which takes --from-tick, --to-tick"),
        ("depth", Choices(frames=0), "found 0 frames, expected one or more"),
    ],
)
def test_choices_that_cannot_be_met_are_refused(name, choices, message, one_scene, tmp_path):
    with pytest.raises(BadRunError, match=message):
        export_scene(one_scene, name, tmp_path / "out", choices)
    assert names(tmp_path) == []


def test_an_unknown_camera_is_named(one_scene, tmp_path):
    with pytest.raises(RigError, match="cam77"):
        export_scene(one_scene, "depth", tmp_path / "out", Choices(camera="cam77"))
    assert names(tmp_path) == []


@pytest.mark.parametrize("folder", [False, True])
def test_a_writer_that_fails_leaves_what_was_there(folder, one_scene, tmp_path, monkeypatch):
    name = "depth" if folder else "ply"
    export_scene(one_scene, name, tmp_path / "out", Choices(frames=2) if folder else Choices())
    before = names(tmp_path / "out") if folder else (tmp_path / "out").read_bytes()

    def breaks(path, scene, choices, progress):
        if folder:
            path.mkdir()
        (path / "half" if folder else path).write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(catalogue, "FORMATS", MappingProxyType({name: replace(FORMATS[name], write=breaks)}))
    with pytest.raises(DiskError, match="No space left"):
        export_scene(one_scene, name, tmp_path / "out", Choices(), overwrite=True)
    assert (names(tmp_path / "out") if folder else (tmp_path / "out").read_bytes()) == before
    assert names(tmp_path) == ["out"]


def test_what_is_made_aside_has_no_final_name_before_it_is_whole(tmp_path):
    def interrupted():
        with made_aside(tmp_path / "out") as aside:
            aside.mkdir()
            (aside / "part").write_text("x")
            assert not (tmp_path / "out").exists()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert names(tmp_path) == []


def test_an_untrained_run_is_refused(tmp_path):
    run = RunFolder.start(tmp_path / "run", ReconstructionConfig(steps=5, budget_s=None), tmp_path / "rec", {})
    with pytest.raises(BadRunError, match="found no finished train stage"):
        trained_scene(run)


def test_listing_the_formats_needs_neither_torch_nor_opencv():
    code = """
import sys
from reconstruction.export.catalogue import FORMATS
print(*FORMATS, *(module for module in ("torch", "cv2", "av") if module in sys.modules))
"""
    listed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert listed == [*FORMATS]


def test_the_readme_names_every_format():
    readme = Path(catalogue.__file__).parents[1].joinpath("README.md").read_text()
    assert [name for name in FORMATS if f"`{name}`" not in readme] == []
