"""Several workers on one database: they share the work, inherit from each other, and outlive the database."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from maintenance.deployment import Deployment
from maintenance.postgresql import PostgresqlMissingError
from maintenance.verdict import STAGES, read_trace
from maintenance.waiting import wait_for

from server.client import RefusedError, ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest

pytestmark = pytest.mark.slow
DATABASES = ["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)]


@pytest.fixture(params=DATABASES)
def deployment(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Deployment]:
    try:
        made = Deployment(tmp_path / "data", postgresql=request.param == "postgresql", dead_s=4.0)
    except PostgresqlMissingError as error:
        pytest.skip(str(error))
    yield made
    made.close()


@pytest.fixture
def client(deployment: Deployment) -> Iterator[ServiceClient]:
    for name in ("api", "a", "b"):
        deployment.start(name)
    with ServiceClient.at(deployment.address) as service:
        wait_for(lambda: answers(service) and {one.id for one in service.workers()} == {"a", "b"})
        yield service


def answers(service: ServiceClient) -> bool:
    try:
        service.info()
        service.workers()
    except (httpx.TransportError, RefusedError):
        return False
    return True


def captured(client: ServiceClient) -> str:
    made = client.start_capture("lab3x3", CaptureRequest(ticks=5))
    wait_for(lambda: client.capture(made.id).status == "done")
    return made.id


def trace(job: Path) -> str:
    return (job / "trace.txt").read_text() if (job / "trace.txt").exists() else ""


def owner(deployment: Deployment, job_id: str) -> str | None:
    """The worker whose stage works on the job now."""
    for pid in deployment.stages():
        try:
            line = Path(f"/proc/{pid}/cmdline").read_text()
        except OSError:
            continue
        if job_id in line:
            return deployment.worker_of(pid)
    return None


def test_workers_share_the_work_and_inherit(client: ServiceClient, deployment: Deployment) -> None:
    capture = captured(client)
    jobs = [client.submit(ReconstructRequest(capture=capture)).id for _ in range(4)]
    owners: dict[str, str] = {}

    def both_at_work() -> bool:
        owners.update({job: name for job in jobs if (name := owner(deployment, job))})
        assert len(deployment.stages()) <= 2
        return set(owners.values()) == {"a", "b"}

    wait_for(both_at_work)
    deployment.kill("b")
    wait_for(lambda: all(client.job(job).status == "done" for job in jobs))
    counts = [read_trace(deployment.data / "jobs" / job) for job in jobs]
    assert [(count["completed"], count["repeated"], count["missing"]) for count in counts] == [(1, 0, 0)] * 4
    assert sum(count["begun"] - count["ended"] for count in counts) <= 1  # the stage that died with its worker
    deployment.stop()
    assert deployment.family() == []
    assert deployment.locked() == []


def test_a_name_belongs_to_one_worker_wherever_its_data_is(
    client: ServiceClient, deployment: Deployment, tmp_path: Path
) -> None:
    if deployment.database is None:
        pytest.skip("the data folder is the database: its lock is tested with one worker")
    second = subprocess.run(
        [sys.executable, "-m", "server.cli", "worker", "--name", "a", "--data", tmp_path / "other"],
        env=os.environ | deployment.database.environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (second.returncode, second.stderr.count("\n")) == (2, 1)
    assert "found another worker a on" in second.stderr
    assert "choose another --name" in second.stderr


def test_a_job_outlives_its_database(client: ServiceClient, deployment: Deployment) -> None:
    if deployment.database is None:
        pytest.skip("SQLite has no process to kill")
    job = client.submit(ReconstructRequest(capture=captured(client))).id
    wait_for(lambda: client.job(job).stage == "train")
    deployment.database.kill()
    codes = set()
    for _ in range(20):
        try:
            codes.add(client.job(job).status)
        except RefusedError as refused:
            codes.add(refused.status)
        time.sleep(0.2)
    assert codes <= {503, "running"}
    assert 503 in codes
    deployment.database.start()
    wait_for(lambda: answers(client) and client.job(job).status == "done")
    count = read_trace(deployment.data / "jobs" / job)
    assert (count["begun"], count["completed"], count["repeated"]) == (len(STAGES), 1, 0)
    assert deployment.dead() == []
    wait_for(lambda: {one.id for one in client.workers()} == {"a", "b"})


def test_who_starts_before_the_database_waits_for_it(deployment: Deployment) -> None:
    if deployment.database is None:
        pytest.skip("SQLite has no process to start")
    deployment.database.kill()
    for name in ("api", "a"):
        deployment.start(name)
    logs = [deployment.data / f"{name}.log" for name in ("api", "a")]
    wait_for(lambda: all("waits for the database" in log.read_text() for log in logs))
    assert deployment.dead() == []
    deployment.database.start()
    with ServiceClient.at(deployment.address) as service:
        wait_for(lambda: answers(service) and [one.id for one in service.workers()] == ["a"])


def test_a_killed_stage_is_resumed_where_it_stopped(client: ServiceClient, deployment: Deployment) -> None:
    job = client.submit(ReconstructRequest(capture=captured(client))).id
    folder = deployment.data / "jobs" / job
    wait_for(lambda: "begin train" in trace(folder) and deployment.stages() != [])
    os.kill(deployment.stages()[0], signal.SIGKILL)
    wait_for(lambda: client.job(job).status == "failed")
    assert client.job(job).error == "the stage ended with SIGKILL and no message"
    client.resume(job)
    wait_for(lambda: client.job(job).status == "done")
    count = read_trace(folder)
    assert (count["begun"], count["completed"], count["repeated"]) == (len(STAGES) + 1, 1, 0)


@pytest.mark.postgres
def test_a_worker_whose_clock_is_a_minute_off_is_told_so_and_works(tmp_path: Path) -> None:
    try:
        deployment = Deployment(tmp_path / "data", postgresql=True, dead_s=4.0)
    except PostgresqlMissingError as error:
        pytest.skip(str(error))
    try:
        deployment.start("api")
        deployment.start("late", late_s=60)
        deployment.start("early", late_s=-60)
        with ServiceClient.at(deployment.address) as client:
            wait_for(lambda: answers(client) and {one.id for one in client.workers()} == {"late", "early"})
            jobs = [client.submit(ReconstructRequest(capture=captured(client))).id for _ in range(3)]
            wait_for(lambda: all(client.job(job).status == "done" for job in jobs))
            assert {one.id for one in client.workers()} == {"late", "early"}
            assert all(one.age_s < 4.0 for one in client.workers())
        for name, way in (("late", "60 s behind"), ("early", "60 s ahead of")):
            assert f"this machine's clock is {way}" in (deployment.data / f"{name}.log").read_text()
        assert deployment.dead() == []
    finally:
        deployment.close()


def test_a_worker_learns_the_rigs_of_the_service(tmp_path: Path) -> None:
    def with_rig(name: str) -> dict[str, str]:
        return {"SPIKE4DGS_RIGS": json.dumps({name: {"rig": "ci3x3", "devices": "mock:fan_and_ball"}})}

    deployment = Deployment(tmp_path / "data", postgresql=False, dead_s=4.0)
    try:
        deployment.start("a")
        log = deployment.data / "a.log"
        wait_for(lambda: "waits for the service to name its rigs" in log.read_text())
        for name in ("first", "of another name"):
            deployment.start("api", environment=with_rig(name))
            with ServiceClient.at(deployment.address) as client:
                wait_for(lambda: answers(client) and [one.id for one in client.workers()] == ["a"])
                made = client.start_capture(name, CaptureRequest(ticks=5))
                wait_for(lambda: client.capture(made.id).status == "done")  # noqa: B023
            assert (deployment.data / "rigs" / name / "drawn.toml").exists()
            deployment.kill("api")
        assert deployment.dead() == []
    finally:
        deployment.close()
