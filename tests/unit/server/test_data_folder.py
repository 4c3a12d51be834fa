"""Tests of the data folder: its place on this machine is hidden whole, and removals hold against others and death."""

import json
import shutil
import tempfile
from pathlib import Path

import pytest

from server.store.files import DataFolder


@pytest.fixture
def folder(tmp_path: Path) -> DataFolder:
    return DataFolder(tmp_path / "data")


def hidden(path: str, text: str, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(Path, "mkdir", lambda *_, **__: None)
    return DataFolder(Path(path)).hidden(text)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("cam00: /data/uploads/u1/data: found 3 bytes", "cam00: uploads/u1/data: found 3 bytes"),
        *((other, other) for other in ("/mnt/data/x", "found /database", "/data-old", "/data.bak: torn")),
        ("found /data.", "found the data folder."),
        ("no room in /data, '/data/jobs' and cam00=/data/x", "no room in the data folder, 'jobs' and cam00=x"),
        ("sqlite:////data/dbos.sqlite", "sqlite:///dbos.sqlite"),
        (json.dumps("torn:\n/data/jobs/j1"), json.dumps("torn:\njobs/j1")),
    ],
)
def test_the_place_of_the_folder_is_hidden_and_no_part_of_another_path(
    text: str, shown: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert hidden("/data", text, monkeypatch) == shown


def test_it_is_hidden_as_json_writes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    place = "/srv/Prüfstand"
    document = json.dumps({"recording": f"{place}/captures/c1", "where": place})
    assert json.loads(hidden(place, document, monkeypatch)) == {"recording": "captures/c1", "where": "the data folder"}


def test_a_folder_that_another_request_removes_first_is_no_error(
    folder: DataFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = folder.recording("c1")
    recording.mkdir()
    mkdtemp = tempfile.mkdtemp

    def slower(prefix: str, dir: Path) -> str:
        shutil.rmtree(recording)
        return mkdtemp(prefix=prefix, dir=dir)

    monkeypatch.setattr(tempfile, "mkdtemp", slower)
    folder.remove(recording)
    assert not list(folder.path.glob(".removed-*"))


def refuse(folder: DataFolder, *removed: Path) -> None:
    with folder.removing(*removed):
        assert not [path for path in removed if path.exists()]
        assert len(list(folder.path.glob(".removed-*/*"))) == 2  # where what a killed process left is swept
        raise KeyError


def test_folders_leave_their_places_first_and_come_back_where_it_is_refused(folder: DataFolder) -> None:
    recording, log = folder.recording("c1"), folder.entry("c1")
    recording.mkdir()
    (log / "log.txt").write_text("said")
    with pytest.raises(KeyError):
        refuse(folder, recording, folder.recording("c2"), log)
    assert recording.exists()
    assert folder.logged("c1") == "said"
    with folder.removing(recording, log):
        pass
    assert not recording.exists()
    assert not list(folder.path.glob(".removed-*"))
