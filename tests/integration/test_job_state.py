"""Tests that the job engine keeps plain JSON, and does not run a pickle put there."""

import base64
import contextlib
import json
import os
import pickle
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for

from server.app import create_app
from server.client import ServiceClient
from server.pickles import PickleError
from server.schemas.captures import CaptureRequest
from server.settings import ServiceSettings

pytestmark = pytest.mark.slow
FAKE = (sys.executable, str(Path(__file__).with_name("fake_stage.py")))


class Hostile:
    """Makes a file when it is unpickled."""

    def __init__(self, witness: Path) -> None:
        self._witness = witness

    def __reduce__(self):
        return os.mkdir, (str(self._witness),)


@pytest.fixture
def service(tmp_path: Path):
    """A service and its data folder, with a function that runs a worker until something is so."""
    data = tmp_path / "data"
    with TestClient(create_app(ServiceSettings(data=data)), base_url="http://127.0.0.1") as http:
        client = ServiceClient(http)

        def work_until(condition: Callable[[], bool]) -> str:
            environment = os.environ | {"SPIKE4DGS_STAGE_COMMAND": json.dumps(FAKE)}
            command = [sys.executable, "-m", "server.cli", "worker", "--data", str(data)]
            worker = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
            try:
                wait_for(condition)
            finally:
                worker.terminate()
                err = worker.communicate(timeout=30)[1]
            return err

        yield client, data, work_until


def rows(data: Path, table: str) -> list[dict]:
    with sqlite3.connect(data / "dbos.sqlite") as connection:
        connection.row_factory = sqlite3.Row
        return [dict(row) for row in connection.execute(f"SELECT * FROM {table}")]


def test_the_job_state_is_json(service) -> None:
    client, data, work_until = service
    done = client.start_capture("lab3x3", CaptureRequest(ticks=40))
    asked = [row["inputs"] for row in rows(data, "workflow_input") if row["workflow_uuid"] == done.id]
    assert len(asked) == 1  # while it waits
    work_until(lambda: client.capture(done.id).status == "done")
    failed = client.start_capture("lab3x3", CaptureRequest(ticks=13))
    work_until(lambda: client.capture(failed.id).status == "failed")
    found = rows(data, "workflow_status")
    assert {row["workflow_uuid"] for row in found} >= {done.id, failed.id}
    texts = [row["error"] for row in found]
    texts += [row[name] for row in rows(data, "operation_outputs") for name in ("output", "error")]
    written = [text for text in asked + texts if text is not None]
    assert len(written) >= 3
    for text in written:
        json.loads(text)
    tables = [row["name"] for row in rows(data, "sqlite_master") if row["type"] == "table"]
    said = [row.get("serialization") for table in tables for row in rows(data, table) if row.get("serialization")]
    assert set(said) == {"portable_json"}


def test_a_hostile_pickle_is_not_run(service, tmp_path: Path) -> None:
    client, data, work_until = service
    alive = tmp_path / "alive"
    pickle.loads(pickle.dumps(Hostile(alive)))
    assert alive.exists()  # it does run where it is read

    witness = tmp_path / "witness"
    text = base64.b64encode(pickle.dumps(Hostile(witness))).decode()
    bad = client.start_capture("lab3x3", CaptureRequest(ticks=40))
    with sqlite3.connect(data / "dbos.sqlite") as connection:
        inputs = connection.execute("UPDATE workflow_input SET inputs=? WHERE workflow_uuid=?", (text, bad.id))
        change = "UPDATE workflow_status SET serialization='py_pickle' WHERE workflow_uuid=?"
        assert inputs.rowcount == connection.execute(change, (bad.id,)).rowcount == 1
    looks = 0

    def over() -> bool:
        """Long after the worker took it."""
        nonlocal looks
        looks += _tried(data, bad.id)
        return looks > 60

    err = work_until(over)
    assert not witness.exists(), err
    for ask in (lambda: client.capture(bad.id), client.captures, lambda: client.rig("lab3x3")):
        ask()
    assert not witness.exists()


def test_the_service_does_not_run_one_either(service, tmp_path: Path) -> None:
    client, data, work_until = service
    failed = client.start_capture("lab3x3", CaptureRequest(ticks=13))
    work_until(lambda: client.capture(failed.id).status == "failed")
    witness = tmp_path / "witness"
    text = base64.b64encode(pickle.dumps(Hostile(witness))).decode()
    with sqlite3.connect(data / "dbos.sqlite") as connection:
        change = "UPDATE operation_outputs SET error=?, serialization='py_pickle' WHERE workflow_uuid=?"
        assert connection.execute(change, (text, failed.id)).rowcount >= 1
    engine = client._http.app.state.services.engine  # type: ignore[attr-defined]
    with contextlib.suppress(PickleError):  # however the engine passes it on
        engine._client.list_workflow_steps(failed.id)
    assert not witness.exists()


def _tried(data: Path, entry_id: str) -> bool:
    (row,) = [row for row in rows(data, "workflow_status") if row["workflow_uuid"] == entry_id]
    return row["status"] not in ("ENQUEUED", "DELAYED")
