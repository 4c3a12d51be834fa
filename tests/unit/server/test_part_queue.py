"""Parts of a training in the job engine, without a worker: handed out once, waited for without a place, never lost."""

import json
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest
import sqlalchemy as sa

from reconstruction.run.parts import STILL, Part, PartFolder
from server.engine import PARTS, RECONSTRUCTIONS, Engine, part_id, steps_of
from server.part_queue import PartQueue, is_at_work, is_lost
from server.services.forecast import Forecast
from server.services.metrics import Metrics
from server.settings import ServiceSettings
from server.store.engine_tables import SPANS, WAITING
from server.store.store import Store
from server.store.tables import Entry
from server.work.part_reporter import PARTS_SHARE, PartReporter
from server.work.parts import Parts
from server.work.processes import Processes

JOB = "j20260101-000000-00000001"


@pytest.fixture
def settings(tmp_path: Path) -> ServiceSettings:
    return ServiceSettings(data=tmp_path)


@pytest.fixture
def store(settings: ServiceSettings) -> Iterator[Store]:
    made = Store(settings)
    yield made
    made.close()


@pytest.fixture
def engine(settings: ServiceSettings, store: Store) -> Iterator[Engine]:
    made = Engine(settings)
    yield made
    made.close()


@pytest.fixture
def queue(engine: Engine) -> PartQueue:
    return PartQueue(engine)


@pytest.fixture
def job(store: Store, engine: Engine) -> Entry:
    entry = Entry(
        id=JOB,
        kind="job",
        type="reconstruct",
        created="2026-01-01",
        request={"type": "reconstruct", "budget_s": 100.0},
        queue=RECONSTRUCTIONS,
        priority=100,
        told="running",
    )
    store.entries.add(entry)
    engine.enqueue(entry)
    return entry


@pytest.fixture
def parts(settings: ServiceSettings, store: Store, queue: PartQueue, job: Entry) -> Parts:
    folder = PartFolder(store.folder.run(JOB))
    (store.folder.run(JOB) / "images").mkdir(parents=True)
    folder.note([Part(STILL, 1.5), Part("000000"), Part("000001")])
    return Parts(store, queue, Processes(settings, store), "a")


def put(engine: Engine, workflow_id: str, **columns: str | None) -> None:
    """Set columns of the engine's, as a worker would have."""
    system = engine.client._sys_db
    table = system.tables.workflow_status
    with system.engine.begin() as connection:
        connection.execute(sa.update(table).where(table.c.workflow_uuid == workflow_id).values(**columns))


def learnt(store: Store, name: str) -> None:
    file = PartFolder(store.folder.run(JOB)).file(name)
    file.parent.mkdir(exist_ok=True)
    file.write_text("")


def test_parts_are_handed_out_before_the_training() -> None:
    steps = ["plan", "poses", "images", "points", PARTS, "train", "report"]
    assert steps_of("reconstruct", {}) == steps
    assert steps_of("reconstruct", {"follow": True}) == ["follow", *steps]
    assert steps_of("verify", {}) == ["verify"]


def test_words_of_the_engine() -> None:
    words = ("ENQUEUED", "DELAYED", "PENDING", "SUCCESS", "ERROR", "CANCELLED", "MAX_RECOVERY_ATTEMPTS_EXCEEDED")
    assert [is_at_work(word) for word in words] == [True] * 3 + [False] * 4
    assert [is_lost(word) for word in words] == [False] * 4 + [True] * 3


def test_a_part_is_handed_out_once_and_again_when_it_was_lost(engine: Engine, queue: PartQueue, job: Entry) -> None:
    queue.hand_out(job, [STILL, "000000"])
    queue.hand_out(job, [STILL])
    assert queue.states(job) == {STILL: "ENQUEUED", "000000": "ENQUEUED"}
    queue.try_again(job, [STILL])  # it has not ended
    put(engine, part_id(JOB, 0, STILL), status="CANCELLED", queue_name=None)
    queue.try_again(job, [STILL, "no such part"])
    assert queue.states(job)[STILL] == "ENQUEUED"
    assert engine.count() == {(RECONSTRUCTIONS, "queued"): 1, (SPANS, "queued"): 2}


def test_a_job_that_waits_runs_and_holds_no_place(engine: Engine, queue: PartQueue, job: Entry) -> None:
    queue.wake(JOB)
    queue.park(JOB, "a")  # it is queued: neither has anything to move
    assert (engine.status(job), queue.forgotten()) == ("queued", [])
    put(engine, JOB, status="PENDING", executor_id="a")
    queue.park(JOB, "b")
    assert queue.forgotten() == []
    queue.park(JOB, "a")
    assert engine.status(job) == "running"
    assert engine.running() == {}
    assert engine.count() == {(RECONSTRUCTIONS, "running"): 1}
    assert [(place.queue, place.runs) for place in engine.places()] == [(WAITING, True)]
    assert queue.forgotten() == [JOB]
    queue.hand_out(job, [STILL])
    assert queue.forgotten() == []
    queue.wake(JOB)
    assert engine.status(job) == "queued"
    assert [(place.queue, place.runs) for place in engine.places()] == [(RECONSTRUCTIONS, False)]


def test_cancelling_reaches_all_parts_and_a_late_wake_does_nothing(
    engine: Engine, queue: PartQueue, job: Entry
) -> None:
    put(engine, JOB, status="PENDING", executor_id="a")
    queue.hand_out(job, [STILL])
    queue.park(JOB, "a")
    engine.cancel(JOB)
    queue.wake(JOB)
    assert engine.status(job) == "cancelled"
    assert queue.states(job) == {STILL: "CANCELLED"}
    assert not queue.is_active(job)
    assert engine.ended() == [JOB]
    engine.forget(JOB)
    assert (queue.states(job), engine.ended()) == ({}, [])


def test_what_a_worker_that_died_has_left_is_handed_on(
    engine: Engine, store: Store, queue: PartQueue, parts: Parts, job: Entry
) -> None:
    put(engine, JOB, status="PENDING", executor_id="a")
    queue.park(JOB, "a")
    parts.look()  # as if it had died before it handed anything out
    assert queue.states(job) == {STILL: "ENQUEUED"}
    learnt(store, STILL)
    parts.look()  # the part is still at work
    assert set(queue.states(job)) == {STILL}
    put(engine, part_id(JOB, 0, STILL), status="SUCCESS")
    parts.look()
    assert set(queue.states(job)) == {STILL, "000000", "000001"}
    for name in ("000000", "000001"):
        put(engine, part_id(JOB, 0, name), status="SUCCESS")
    parts.look()  # their files are not seen yet: they are not learnt a second time
    assert engine.status(job) == "queued"


def test_a_job_that_has_ended_is_not_gone_on_with(engine: Engine, queue: PartQueue, parts: Parts, job: Entry) -> None:
    put(engine, JOB, status="CANCELLED", queue_name=WAITING)
    parts.look()
    assert queue.states(job) == {}


def test_a_shared_folder_that_is_away_is_waited_for(
    engine: Engine, queue: PartQueue, parts: Parts, job: Entry, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(engine, JOB, status="PENDING", executor_id="a")
    queue.park(JOB, "a")
    with monkeypatch.context() as away:
        away.setattr(PartFolder, "there", lambda self: (_ for _ in ()).throw(OSError(5, "Input/output error")))
        parts.look()
    assert queue.states(job) == {}
    parts.look()
    assert queue.states(job) == {STILL: "ENQUEUED"}


@pytest.mark.parametrize("workers", [0, 1, 4])
def test_the_seconds_left_are_shared_by_the_workers(
    engine: Engine, store: Store, queue: PartQueue, job: Entry, workers: int
) -> None:
    for number in range(workers):
        store.workers.enter(f"w{number}", [RECONSTRUCTIONS])
    store.entries.change(JOB, progress={"stage": "train", "fraction": 0.2, "seconds": {"plan": 4.0, "train": 16.0}})
    put(engine, JOB, status="PENDING", executor_id="a")
    queue.park(JOB, "a")
    begun = store.clock()
    outlook = Forecast(store, engine).of([JOB])[JOB]
    assert outlook.position is None
    if not workers:
        assert outlook.expected_end is None
        return
    assert outlook.expected_end is not None
    left_s = datetime.fromisoformat(outlook.expected_end).timestamp() - begun
    assert left_s == pytest.approx(80 / workers, abs=2)  # of a budget of 100


def test_parts_are_counted_as_spans(
    settings: ServiceSettings, store: Store, engine: Engine, queue: PartQueue, job: Entry
) -> None:
    queue.hand_out(job, [STILL])
    text = Metrics(settings, store, engine).text().decode()
    assert f'spike4dgs_queue_depth{{queue="{SPANS}",status="queued"}} 1.0' in text
    assert WAITING not in text


def test_progress_is_of_all_parts_and_seconds_add_up(store: Store, parts: Parts) -> None:
    learnt(store, STILL)
    two = [PartReporter(store, JOB, name) for name in ("000000", "000001")]
    for reporter, share in zip(two, (0.5, 0.25), strict=True):
        reporter(share, f"at {share}")
        reporter.warn("look at this")
        reporter._write()
    (entry,) = store.entries.find([JOB])
    assert entry.progress["fraction"] == pytest.approx(PARTS_SHARE * (1.5 + 0.75) / 3.5)
    assert entry.progress["message"] == "1 of 3 parts; at 0.25"
    assert entry.progress["warnings"] == ["look at this"]
    learnt(store, "000000")
    for reporter in two:
        reporter.close()
    (entry,) = store.entries.find([JOB])
    assert entry.progress["fraction"] == pytest.approx(PARTS_SHARE * 2.5 / 3.5)
    assert json.dumps(entry.progress["running"]) == "{}"
