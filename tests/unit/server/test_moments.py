"""Tests when a capture may begin."""

import asyncio
import signal
from datetime import UTC, datetime, timedelta

import pytest

from server.cli.operator import operator_control
from server.settings import ServiceSettings
from server.store.store import Store
from server.store.tables import Entry
from server.work.moments import Beginning, Moments
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


def test_being_cut_off_twice_is_being_cut_off():
    with operator_control(saves=False) as control:
        for _ in range(3):
            signal.raise_signal(signal.SIGUSR1)
        assert control.cut_off.is_set()
        assert not control.stop.is_set()
