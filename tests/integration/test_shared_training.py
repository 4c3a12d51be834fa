"""The training of a long recording as tasks of all workers. Stages and parts are played by stand_in_stage.py."""

import json
import os
import signal
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import httpx
import pytest
from maintenance.deployment import Deployment
from maintenance.postgresql import PostgresqlMissingError
from maintenance.verdict import STAGES, read_trace
from maintenance.waiting import wait_for

from server.client import RefusedError, ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest, VerifyRequest
from server.schemas.jobs import Job

pytestmark = pytest.mark.slow
DATABASES = ["sqlite", pytest.param("postgresql", marks=[pytest.mark.postgres, pytest.mark.long])]


@pytest.fixture(scope="module", params=DATABASES)
def deployment(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    try:
        data = tmp_path_factory.mktemp("service") / "data"
        made = Deployment(data, postgresql=request.param == "postgresql", dead_s=3.0, step_s=0.02)
    except PostgresqlMissingError as error:
        pytest.skip(str(error))
    made.start("api")
    yield made
    made.close()


@pytest.fixture(scope="module")
def client(deployment: Deployment) -> Iterator[ServiceClient]:
    with ServiceClient.at(deployment.address) as service:
        wait_for(lambda: answers(service))
        yield service


@pytest.fixture
def both(deployment: Deployment, client: ServiceClient) -> None:
    at_work(deployment, client, "a", "b")


@pytest.fixture
def one(deployment: Deployment, client: ServiceClient) -> None:
    at_work(deployment, client, "a")


@pytest.fixture(scope="module")
def capture(deployment: Deployment, client: ServiceClient) -> str:
    at_work(deployment, client, "a")
    made = client.start_capture("lab3x3", CaptureRequest(ticks=5))
    wait_for(lambda: client.capture(made.id).status == "done")
    return made.id


def answers(service: ServiceClient) -> bool:
    try:
        service.workers()
    except (RefusedError, httpx.TransportError):
        return False
    return True


def at_work(deployment: Deployment, client: ServiceClient, *names: str) -> None:
    """Let these workers, and no others, be at work."""
    for name in {"a", "b"} & set(deployment.processes) - set(names):
        process = deployment.processes.pop(name)
        process.terminate()
        process.wait(60)
    for name in set(names) - set(deployment.processes):
        deployment.start(name)
    wait_for(lambda: {found.id for found in client.workers()} == set(names))


class Watched:
    """A job of so many spans, its folder, and what happened to its parts."""

    def __init__(self, deployment: Deployment, client: ServiceClient, capture: str, spans: int, *held: str) -> None:
        self.deployment = deployment
        self.client = client
        self.id = client.submit(ReconstructRequest(capture=capture, seed=spans)).id
        self.folder = deployment.data / "jobs" / self.id
        for word in held:
            self.mark(word)

    def mark(self, word: str) -> None:
        self.folder.mkdir(exist_ok=True)
        (self.folder / word).write_text("")

    def unmark(self, word: str) -> None:
        (self.folder / word).unlink()

    @property
    def now(self) -> Job:
        return self.client.job(self.id)

    def there(self) -> set[str]:
        return {path.stem for path in (self.folder / "run" / "spans").glob("*.pt")}

    def begun(self) -> Counter[str]:
        """Count the begins of each part."""
        text = (self.folder / "trace.txt").read_text() if (self.folder / "trace.txt").exists() else ""
        return Counter(line.split()[1] for line in text.splitlines() if line.startswith("part"))

    def processes(self) -> dict[int, str]:
        """Process ids of the stages and parts that run now, and what they do."""
        found = {}
        for pid in self.deployment.stages():
            try:
                words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
            except (FileNotFoundError, ProcessLookupError):  # it has ended since it was listed
                continue
            if any(self.id in word for word in words):
                found[pid] = words[words.index("--part" if "--part" in words else "--stage") + 1]
        return found

    def ends(self, status: str = "done") -> None:
        wait_for(lambda: self.now.status not in ("queued", "running") and self.now.status == status)


def test_one_worker_alone_finishes_and_other_work_is_done_between(one, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 6, "hold-000002")
    wait_for(lambda: "000002" in job.processes().values())
    assert (job.now.status, job.now.stage) == ("running", "train")
    assert 0 < job.now.fraction < 0.95
    assert "parts; " in job.now.message
    assert next(found.id for found in client.jobs(order="work")) == job.id
    check = client.submit(VerifyRequest(type="verify", capture=capture)).id
    wait_for(lambda: client.job(check).status == "done")
    small = client.submit(ReconstructRequest(capture=capture)).id
    assert client.job(small).status == "queued"  # one training at a time on a worker
    job.unmark("hold-000002")
    wait_for(lambda: client.job(small).status == "done")
    assert len(job.there()) < 7
    assert job.now.status == "running"
    job.ends()
    assert job.there() == {"still", *(f"{number:06d}" for number in range(6))}
    assert set(job.begun().values()) == {1}
    assert read_trace(job.folder)["begun"] == len(STAGES)
    assert job.now.seconds["train"] > 0
    assert {step.status for step in client.steps(job.id)} == {"done"}


def test_two_workers_share_a_training_and_one_inherits_from_the_other(both, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 8)
    taken: dict[str, str | None] = {}

    def both_learn() -> bool:
        taken.update({part: deployment.worker_of(pid) for pid, part in job.processes().items() if part[0] == "0"})
        return {"a", "b"} <= set(taken.values())

    wait_for(both_learn)
    deployment.kill("b")
    job.ends()
    assert len(job.there()) == 9
    assert sum(job.begun().values()) <= 10  # the part that died with its worker
    assert read_trace(job.folder)["completed"] == 1


def test_a_worker_that_was_killed_goes_on_with_its_part(one, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 2, "hold-still")
    wait_for(lambda: job.begun() == {"still": 1})
    deployment.kill("a")
    job.unmark("hold-still")
    assert job.now.status == "running"
    deployment.start("a")
    job.ends()
    assert job.begun() == {"still": 2, "000000": 1, "000001": 1}


def test_a_part_that_fails_thrice_is_left_out_with_a_warning(both, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 3, "fail-000001", "refuse-000002")
    job.ends()
    assert job.begun() == {"still": 1, "000000": 1, "000001": 3, "000002": 1}  # bad input fails at once
    assert job.there() == {"still", "000000"}
    assert job.now.warnings == [
        "000001.failed.json after 3: found a fault in 000001, expected none; mend it",
        "000002.failed.json after 1: found a fault in 000002, expected none; mend it",
    ]
    for word in ("fail-000001", "refuse-000002"):
        job.unmark(word)
    client.restart(job.id, "train")
    job.ends()
    assert (len(job.there()), job.now.warnings) == (4, [])


def test_without_a_still_scene_a_job_fails_and_is_tried_again(both, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 2, "fail-still")
    job.ends("failed")
    assert (job.now.stage, job.now.error) == ("train", "found a fault in still, expected none; mend it")
    assert job.begun() == {"still": 3}
    job.unmark("fail-still")
    client.resume(job.id)
    job.ends()
    assert job.begun() == {"still": 4, "000000": 1, "000001": 1}


def test_a_full_disk_gives_no_part_up(both, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 3, "fill-000001")
    job.ends("failed")
    assert job.now.error == "part 000001 of the training: found a fault in 000001, expected none; mend it"
    assert job.now.resumable
    job.unmark("fill-000001")
    client.resume(job.id)
    job.ends()
    assert job.begun() == {"still": 1, "000000": 1, "000001": 2, "000002": 1}


def resumed(client: ServiceClient, job_id: str) -> Job:
    """Resume a cancelled job as soon as the last of its processes is gone, as the service advises."""
    found = []

    def again() -> bool:
        try:
            found.append(client.resume(job_id))
        except RefusedError as error:
            if "still stopping" not in str(error):
                raise
        return bool(found)

    wait_for(again)
    return found[0]


def test_cancelling_a_job_cancels_its_parts(both, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 5, "hold-000000", "hold-000001")
    wait_for(lambda: set(job.processes().values()) == {"000000", "000001"})
    assert client.cancel(job.id).status == "cancelled"
    wait_for(lambda: job.processes() == {})
    with pytest.raises(RefusedError, match="expected it queued or running"):
        client.cancel(job.id)
    before = job.begun()
    for word in ("hold-000000", "hold-000001"):
        job.unmark(word)
    assert resumed(client, job.id).status == "queued"
    job.ends()
    assert len(job.there()) == 6
    assert job.begun() - before == {f"{number:06d}": 1 for number in range(5)}
    client.delete_job(job.id)
    assert not job.folder.exists()


@pytest.mark.parametrize("stage", ["points", "train"])
def test_a_restart_learns_all_parts_again(both, deployment, client, capture, stage) -> None:
    job = Watched(deployment, client, capture, 2)
    job.ends()
    client.restart(job.id, stage)
    job.ends()
    assert set(job.begun().values()) == {2}
    assert json.loads((job.folder / "run" / "run.json").read_text())["attempt"] == 1
    client.restart(job.id, "report")
    job.ends()
    assert set(job.begun().values()) == {2}


def put_to_sleep(processes: list[int], data: Path) -> None:
    """Stop processes, at a moment when none holds a lock on SQLite: it would keep all others from writing."""
    for _ in range(50):
        for pid in processes:
            os.kill(pid, signal.SIGSTOP)
        if all(map(is_writable, data.glob("*.sqlite"))):
            return
        for pid in processes:
            os.kill(pid, signal.SIGCONT)
        time.sleep(0.05)
    raise AssertionError("a database was locked whenever the processes were stopped")


def is_writable(database: Path) -> bool:
    with closing(sqlite3.connect(database, timeout=1.0)) as connection:
        try:
            connection.execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError:
            return False
        connection.rollback()
        return True


def test_a_result_that_comes_late_is_dropped(both, deployment, client, capture) -> None:
    job = Watched(deployment, client, capture, 1, "hold-000000")
    wait_for(lambda: "000000" in job.processes().values())
    ((late, _),) = job.processes().items()
    name = deployment.worker_of(late)
    assert name is not None
    asleep = [deployment.processes[name].pid, late]
    put_to_sleep(asleep, deployment.data)
    job.unmark("hold-000000")
    job.ends()
    kept = (job.folder / "run" / "spans" / "000000.pt").read_text()
    assert kept != str(late)
    for pid in asleep:
        os.kill(pid, signal.SIGCONT)
    wait_for(lambda: "part 000000: dropped" in client.log(job.id))
    assert (job.folder / "run" / "spans" / "000000.pt").read_text() == kept
    assert job.now.status == "done"
    assert read_trace(job.folder)["completed"] == 1
    assert job.begun() == {"still": 1, "000000": 2}
    assert deployment.dead() == []


def test_nothing_is_left_running_or_locked(both, deployment, client, capture) -> None:
    figures = httpx.get(f"{deployment.address}/metrics", trust_env=False).text
    assert 'spike4dgs_queue_depth{queue="spans",status="running"} 0.0' in figures
    deployment.stop()
    assert deployment.family() == []
    assert deployment.locked() == []
