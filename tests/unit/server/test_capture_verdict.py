"""Tests that the verdict on a campaign of faults sees each kind of fault, and none where there is none."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maintenance.capture_clients import Asked
from maintenance.capture_verdict import FAULTS, Left, judge_captures

from acquisition.recording.manifest import Trigger
from acquisition.recording.writer import RecordingWriter, partial_of
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform
from server.schemas.captures import Capture

LAYOUT = PlaneLayout(9, 5)
ONE = "c20260101-000000-00000001"
REASON = "the recorder was killed"
TRIGGER: Trigger = "line"


class Scene:
    """A data folder with captures as a campaign might leave them."""

    def __init__(self, data: Path) -> None:
        self.data = data
        self.asked: dict[str, Asked] = {}
        self.shown: dict[str, Capture] = {}
        self.kept: dict[str, int] = {}
        (data / "captures").mkdir()

    def capture(self, status: str = "done", *, stopped: bool = False, begun: int = 1, **shown: Any) -> Path:
        """Note the accepted capture ONE; return where its recording lies."""
        request = shown.pop("request", {"ticks": 100})
        self.asked[ONE] = Asked(request, "left", stopped=stopped)
        known = {
            "id": ONE,
            "type": "record",
            "rig": "left",
            "ticks": None,
            "name": None,
            "created": "",
            "status": status,
        }
        self.shown[ONE] = Capture.model_validate(known | shown)
        with (self.data / "captures.trace").open("a") as trace:
            trace.write(f"record {ONE} 7\n" * begun)
        return self.data / "captures" / ONE

    def recorded(self, path: Path, planes: tuple[int, int] = (100, 100), reason: str | None = None) -> Path:
        """Record so many planes of two cameras, incomplete for a reason."""
        cameras = tuple(Camera(i, 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()) for i in ("a", "b"))
        with RecordingWriter(path, Rig("pair", 20_000.0, cameras)) as recording:
            streams = [recording.stream(camera.id, LAYOUT) for camera in cameras]
            recording.mark("recording", TRIGGER)
            for stream, number in zip(streams, planes, strict=True):
                stream.append(np.full((number, LAYOUT.plane_bytes), 3, dtype=np.uint8))
                stream.close()
            recording.problems += [reason] if reason else []
            recording.commit(recording.entries(), TRIGGER)
        return path

    def faults(self) -> list[str]:
        """The kinds of fault that the verdict finds; its counts say the same."""
        rows, counts = judge_captures(Left(self.data, self.asked, self.shown, self.kept))
        found = [fault for row in rows for fault in row["faults"]]
        assert [counts[name] for name in FAULTS] == [found.count(name) for name in FAULTS]
        return found


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene(tmp_path)


def test_a_whole_one_has_no_fault(scene: Scene) -> None:
    scene.recorded(scene.capture())
    assert scene.faults() == []


def test_one_that_says_what_it_lacks_has_no_fault(scene: Scene) -> None:
    scene.recorded(scene.capture(message=f"kept, incomplete: {REASON}"), (60, 40), REASON)
    scene.kept[ONE] = 60
    assert scene.faults() == []


@pytest.mark.parametrize(
    ("status", "text"), [("failed", {"error": "no answer"}), ("cancelled", {"message": "stopped"})]
)
def test_one_that_failed_or_was_stopped_with_a_reason_has_no_fault(scene: Scene, status: str, text: dict) -> None:
    scene.capture(status, stopped=True, **text)
    assert scene.faults() == []


def test_a_lost_one(scene: Scene) -> None:
    scene.capture()
    del scene.shown[ONE]
    assert scene.faults() == ["lost"]


def test_one_that_nobody_asked_for(scene: Scene) -> None:
    scene.recorded(scene.capture())
    del scene.asked[ONE]
    assert scene.faults() == ["doubled"]


def test_one_that_was_begun_twice(scene: Scene) -> None:
    scene.recorded(scene.capture(begun=2))
    assert scene.faults() == ["doubled"]


@pytest.mark.parametrize("status", ["queued", "running"])
def test_one_that_never_ended(scene: Scene, status: str) -> None:
    scene.capture(status)
    assert scene.faults() == ["undone"]


@pytest.mark.parametrize("status", ["failed", "cancelled"])
def test_one_that_ended_without_a_reason(scene: Scene, status: str) -> None:
    scene.capture(status, stopped=True)
    assert scene.faults() == ["unexplained"]


def test_one_that_is_done_with_an_error(scene: Scene) -> None:
    scene.recorded(scene.capture(error="it was killed"))
    assert scene.faults() == ["unexplained"]


def test_one_that_was_cancelled_by_nobody(scene: Scene) -> None:
    scene.capture("cancelled", message="stopped")
    assert scene.faults() == ["unexplained"]


@pytest.mark.parametrize("planes", [(99, 99), (100, 90), (101, 101)])
def test_one_called_complete_with_other_planes_than_were_asked_for(scene: Scene, planes: tuple[int, int]) -> None:
    scene.recorded(scene.capture(), planes)
    assert scene.faults() == ["false_complete"]


def test_one_called_complete_whose_end_nobody_asked_for(scene: Scene) -> None:
    path = scene.recorded(scene.capture(request={"until_stopped": True}))
    assert scene.faults() == ["false_complete"]
    scene.asked[ONE].stopped = True
    assert path.exists()
    assert scene.faults() == []


def test_one_called_complete_that_was_never_saved(scene: Scene) -> None:
    scene.recorded(scene.capture(request={"until_stopped": True, "pre_trigger_ms": 5.0}, stopped=True))
    assert scene.faults() == ["false_complete"]


def test_one_called_done_without_a_recording(scene: Scene) -> None:
    scene.capture()
    assert scene.faults() == ["false_complete"]


def test_an_incomplete_one_that_does_not_say_so(scene: Scene) -> None:
    scene.recorded(scene.capture(), (60, 40), REASON)
    assert scene.faults() == ["false_complete"]


def test_one_with_other_planes_than_its_killed_recorder_had(scene: Scene) -> None:
    scene.recorded(scene.capture(message=REASON), (60, 40), REASON)
    scene.kept[ONE] = 80
    assert scene.faults() == ["altered"]


def test_a_torn_file(scene: Scene) -> None:
    path = scene.recorded(scene.capture())
    data = (path / "a.dat").read_bytes()
    (path / "a.dat").write_bytes(data[:-1])
    assert scene.faults() == ["torn"]
    (path / "a.dat").write_bytes(data[:-1] + b"\7")
    assert scene.faults() == ["torn"]
    (path / "a.dat").write_bytes(data)
    (path / ".recording.json.5.partial").write_bytes(b"{")
    assert scene.faults() == ["torn"]


def test_a_torn_manifest(scene: Scene) -> None:
    path = scene.recorded(scene.capture())
    text = (path / "recording.json").read_text()
    (path / "recording.json").write_text(text[: len(text) // 2])
    assert scene.faults() == ["torn"]


@pytest.mark.parametrize("status", ["failed", "cancelled"])
def test_a_recording_of_one_that_is_not_called_done(scene: Scene, status: str) -> None:
    scene.recorded(scene.capture(status, stopped=True, message="x"))
    assert scene.faults() == ["hidden"]


def test_planes_that_nobody_is_told_of(scene: Scene) -> None:
    path = scene.capture("failed", error="no answer")
    scene.recorded(path).rename(partial_of(path))
    assert scene.faults() == ["hidden"]
    scene.shown[ONE].partial_planes = 100
    assert scene.faults() == []


def test_files_of_no_capture(scene: Scene) -> None:
    path = scene.recorded(scene.capture())
    shutil.copytree(path, path.with_name("c20260101-000000-00000002.partial"))
    assert scene.faults() == ["hidden"]
