"""Tests when a capture may begin."""

import asyncio
import json
import signal
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from acquisition.devices.open import Simulation
from acquisition.recording.manifest import MANIFEST_FILE
from acquisition.recording.writer import partial_of
from acquisition.session.record import simulate
from rigs.toml import catalog_rig
from server.cli.operator import operator_control
from server.schemas.captures import ImportRequest
from server.settings import ServiceSettings
from server.store.store import Store
from server.store.tables import Entry
from server.work import stages as stages_module
from server.work.moments import Beginning, Moments
from server.work.stages import Stages
from server.work.supervisor import KilledError, StageError, StoppedStageError


@pytest.fixture
def beginning_of(tmp_path):
    """Return the beginning of a capture that was asked for so many seconds ago."""
    store = Store(ServiceSettings(data=tmp_path))

    def make(late_s: float) -> Beginning:
        asked = (datetime.now(UTC) - timedelta(seconds=late_s)).isoformat()
        return Beginning(store, Entry("c1", "capture", "record", asked, {"ticks": 40}))

    yield make
    store.close()


@pytest.mark.parametrize("late_s", [-60, 0, 40])
def test_it_begins_once(beginning_of, late_s):
    assert beginning_of(late_s).is_now()
    assert not beginning_of(late_s).is_now()
    assert not beginning_of(100).is_now()


def test_one_stopped_before_it_began_does_not_begin(beginning_of):
    beginning_of(0).control.stop.touch()
    with pytest.raises(StoppedStageError, match="stopped before it began"):
        beginning_of(0).is_now()


def test_one_that_nobody_took_up_is_missed(beginning_of):
    with pytest.raises(StageError, match=r"took it up for 100 s, expected one within 60 s; record again"):
        beginning_of(100).is_now()


def test_one_that_a_worker_of_old_has_begun_does_not_begin_again(beginning_of, tmp_path):
    (tmp_path / "captures" / "c1.partial").mkdir(parents=True)
    assert not beginning_of(100).is_now()


class Killed:
    """Processes of which each is killed by the signal `number`, before it has kept anything."""

    def __init__(self, number: int) -> None:
        self.number = number

    async def run(self, *arguments: object, **options: object) -> None:
        raise KilledError("the stage ended", self.number)


@pytest.mark.parametrize(
    ("number", "stopped", "kind", "text"),
    [
        (signal.SIGTERM, True, StoppedStageError, "stopped before it began"),
        (signal.SIGTERM, False, StageError, "cut off before its first planes"),
        (signal.SIGKILL, True, StageError, "cut off before its first planes"),
    ],
)
def test_a_recorder_killed_before_its_first_planes_was_stopped_or_missed(tmp_path, number, stopped, kind, text):
    store = Store(ServiceSettings(data=tmp_path))
    entry = Entry("c1", "capture", "record", store.entries.now(), {"ticks": 40})
    store.entries.add(entry)
    if stopped:
        Beginning(store, entry).control.stop.touch()
    with pytest.raises(StageError, match=text) as raised:
        asyncio.run(Moments(store, Killed(number)).record(entry, "record", "r", "usb:", tmp_path))
    assert type(raised.value) is kind
    (kept,) = store.entries.find(["c1"])
    assert text in (kept.progress["message"] if stopped and kind is StoppedStageError else kept.progress["error"])
    store.close()


class Late:
    """Processes of which the one named `last` is killed, when it has given its recording the name."""

    def __init__(self, last: str, recording: Path) -> None:
        self.last, self.recording = last, recording

    async def run(self, entry: Entry, stage: str, arguments: list[str], **options: object) -> None:
        if arguments[0] == self.last:
            simulate(Simulation("fan_and_ball", samples=1), catalog_rig("ci3x3").scaled(20, 12), 20, self.recording)
        else:
            partial_of(self.recording).mkdir(parents=True)
            options["is_due"]()  # type: ignore[operator]
        if arguments[0] == self.last:
            raise KilledError("the stage ended with SIGKILL and no message", signal.SIGKILL)


@pytest.mark.parametrize("last", ["record", "finalise"])
def test_what_was_killed_when_it_had_a_name_is_kept(tmp_path, last):
    store = Store(ServiceSettings(data=tmp_path))
    entry = Entry("c1", "capture", "record", store.entries.now(), {"ticks": 20})
    store.entries.add(entry)
    processes = Late(last, store.folder.recording("c1"))
    asyncio.run(Moments(store, processes).record(entry, "record", "r", "usb:", tmp_path))
    (kept,) = store.entries.find(["c1"])
    assert (kept.progress["message"], kept.progress["error"]) == ("kept, complete", None)
    store.close()


class Orphaned:
    """Processes that find what they are asked for finished by one that outlived its worker."""

    def __init__(self, recording: Path) -> None:
        self.recording = recording

    async def run(self, *arguments: object, **options: object) -> None:
        simulate(Simulation("fan_and_ball", samples=1), catalog_rig("ci3x3").scaled(20, 12), 20, self.recording)
        manifest = self.recording / MANIFEST_FILE
        told = {"status": "incomplete", "reason": "the recorder was killed"}
        manifest.write_text(json.dumps(json.loads(manifest.read_text()) | told))


def test_what_an_earlier_worker_left_incomplete_is_called_so_by_the_next(tmp_path):
    store = Store(ServiceSettings(data=tmp_path))
    entry = Entry("c1", "capture", "record", store.entries.now(), {"ticks": 20})
    store.entries.add(entry)
    assert Beginning(store, entry).is_now()
    processes = Orphaned(store.folder.recording("c1"))
    asyncio.run(Moments(store, processes).record(entry, "record", "r", "usb:", tmp_path))
    (kept,) = store.entries.find(["c1"])
    assert kept.progress["message"] == "kept, incomplete: the recorder was killed"
    store.close()


def test_an_import_that_was_killed_when_it_had_a_name_is_kept(tmp_path, monkeypatch):
    settings = ServiceSettings(data=tmp_path)
    store = Store(settings)
    asked = ImportRequest(uploads=["a"], cameras="b", tick_rate_hz=20_000).model_dump()
    entry = Entry("c1", "capture", "import", store.entries.now(), asked | {"dats": ["a"], "ids": None})
    store.entries.add(entry)
    processes = Late("import", store.folder.recording("c1"))
    monkeypatch.setattr(stages_module, "Processes", lambda *given: processes)
    asyncio.run(Stages(settings, store).run("c1", "import"))
    (kept,) = store.entries.find(["c1"])
    assert (kept.progress["message"], kept.progress["error"]) == ("kept, complete", None)
    store.close()


def test_being_cut_off_twice_is_being_cut_off():
    with operator_control(saves=False) as control:
        for _ in range(3):
            signal.raise_signal(signal.SIGUSR1)
        assert control.cut_off.is_set()
        assert not control.stop.is_set()
