"""kill -9 of the worker: the next one finishes what it had begun. Stages are played by fake_stage.py."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for
from sqlalchemy.exc import OperationalError

from acquisition.session.record import record
from rigs.toml import catalog_rig
from server.app import create_app
from server.client import ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest
from server.settings import ServiceSettings
from server.store.store import Store
from server.work import worker

FAKE = json.dumps([sys.executable, str(Path(__file__).with_name("fake_stage.py"))])
pytestmark = pytest.mark.slow


@pytest.fixture
def client(tmp_path: Path) -> Iterator[ServiceClient]:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as http:
        yield ServiceClient(http)


@pytest.fixture
def start_worker(tmp_path: Path) -> Iterator[Callable[[], subprocess.Popen[bytes]]]:
    workers: list[subprocess.Popen[bytes]] = []

    def start() -> subprocess.Popen[bytes]:
        environment = os.environ | {"SPIKE4DGS_STAGE_COMMAND": FAKE, "FAKE_STEPS": "150", "FAKE_STEP_S": "0.02"}
        workers.append(
            subprocess.Popen([sys.executable, "-m", "server.cli", "worker", "--data", tmp_path], env=environment)
        )
        return workers[-1]

    yield start
    for one in workers:
        one.terminate()
        one.wait(20)


def attempts(run: Path) -> list[tuple[int, int]]:
    """Process id and first step of every attempt at the train stage."""
    text = (run / "attempts.txt").read_text() if (run / "attempts.txt").exists() else ""
    return [(int(pid), int(first)) for pid, first in (line.split() for line in text.splitlines())]


def start_job(client: ServiceClient) -> str:
    capture = client.start_capture("lab3x3", CaptureRequest(ticks=40))
    wait_for(lambda: client.capture(capture.id).status == "done")
    return client.submit(ReconstructRequest(capture=capture.id)).id


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_training_goes_on_from_its_checkpoint(
    client: ServiceClient, start_worker: Callable[[], subprocess.Popen[bytes]], tmp_path: Path, number: signal.Signals
) -> None:
    killed = start_worker()
    job = start_job(client)
    run = tmp_path / "jobs" / job / "run"
    wait_for(lambda: (run / "checkpoint.json").exists())
    killed.send_signal(number)
    assert killed.wait(20) == (0 if number == signal.SIGTERM else -signal.SIGKILL)
    ((pid, first),) = attempts(run)
    wait_for(lambda: not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    done = json.loads((run / "checkpoint.json").read_text())["done"]
    assert first == 0
    assert 0 < done < 150
    assert client.job(job).status == "running"
    assert ("stopped with a checkpoint" in client.log(job)) == (number == signal.SIGTERM)
    assert [capture.status for capture in client.captures()] == ["done"]

    start_worker()
    wait_for(lambda: client.job(job).status == "done")
    assert [first for _, first in attempts(run)] == [0, done]
    stages = [line.split()[2] for line in client.log(job).splitlines() if line.startswith("arguments")]
    assert stages == ["plan", "poses", "images", "points", "train", "train", "report"]


def test_a_finished_capture_is_kept(
    client: ServiceClient, start_worker: Callable[[], subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    killed = start_worker()
    capture = client.start_capture("lab3x3", CaptureRequest(ticks=40))
    wait_for(lambda: any((tmp_path / "captures").glob(".*.aside")))
    killed.kill()
    killed.wait(20)
    assert client.capture(capture.id).status == "running"
    assert client.rig("lab3x3").busy == capture.id
    recording = tmp_path / "captures" / capture.id
    record(catalog_rig("ci3x3"), "mock:static?truth_every=1000", 40, recording)  # as if its worker had died after it
    inode = recording.stat().st_ino
    start_worker()
    wait_for(lambda: client.capture(capture.id).status == "done")
    assert recording.stat().st_ino == inode
    assert client.rig("lab3x3").busy is None


def test_a_stage_that_the_run_calls_finished_is_not_begun_again(
    client: ServiceClient, start_worker: Callable[[], subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    killed = start_worker()
    job = start_job(client)
    run = tmp_path / "jobs" / job / "run"
    wait_for(lambda: (run / "checkpoint.json").exists())
    killed.kill()
    killed.wait(20)
    document = {"status": "unfinished", "seconds": dict.fromkeys(("plan", "poses", "images", "points", "train"), 1.0)}
    (run / "run.json").write_text(
        json.dumps(document)
    )  # as if the worker had died between the stage's end and the mark
    start_worker()
    wait_for(lambda: client.job(job).status == "done")
    assert len(attempts(run)) == 1
    assert {step.status for step in client.steps(job)} == {"done"}
    assert "run.json" in [one.name for one in client.artefacts(job)]


def test_a_worker_that_loses_its_database_while_it_starts_starts_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    launch, tries = worker._launch, []

    def launch_badly(*arguments: Any) -> None:
        launch(*arguments)
        tries.append(arguments)
        if len(tries) == 1:
            raise OperationalError("INSERT", {}, sqlite3.OperationalError("database is locked"))

    monkeypatch.setattr(worker, "_launch", launch_badly)
    stop = threading.Event()
    settings = ServiceSettings(data=tmp_path)
    thread = threading.Thread(target=worker.run_worker, args=(settings, "a", ("tasks",), stop))
    thread.start()
    wait_for(lambda: len(tries) == 2)
    store = Store(settings)
    wait_for(lambda: [one.id for one in store.workers.alive()] == ["a"])
    stop.set()
    thread.join(20)
    assert not thread.is_alive()
    assert store.workers.alive() == []
    store.close()
