"""A data folder that revision 6b89514 left when it was killed: it is taken over, and its jobs finish.

The archive has a capture, a job that is done, one that was cancelled, one that was training, one that was queued, a
committed upload and one half sent. Two of the jobs asked for the supervision of old, `variation`. Stages stood in.
"""

import json
import sqlite3
import tarfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient
from maintenance.deployment import Deployment
from maintenance.verdict import read_trace
from maintenance.waiting import wait_for

from server.app import create_app
from server.cli.main import cli
from server.client import ServiceClient
from server.schemas.job_types import ReconstructRequest
from server.settings import ServiceSettings
from server.store.migration import FORMAT
from server.store.soundness import DatabaseError
from server.store.store import Store

ARCHIVE = Path(__file__).with_name("data-folder-6b89514.tar.gz")


@pytest.fixture
def data(tmp_path: Path) -> Path:
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path / "data"


@pytest.fixture
def names(data: Path) -> dict[str, str]:
    return json.loads((data / "names.json").read_text())


@pytest.fixture
def client(data: Path) -> Iterator[ServiceClient]:
    with TestClient(create_app(ServiceSettings(data=data)), base_url="http://127.0.0.1") as http:
        yield ServiceClient(http)


def test_entries_of_old_are_shown_as_they_were(client, names) -> None:
    jobs = {job.id: job for job in client.jobs()}
    assert jobs[names["done"]].status == client.capture(names["capture"]).status == "done"
    assert jobs[names["cancelled"]].status == "cancelled"
    assert jobs[names["running"]].stage == "train"
    asked = [ReconstructRequest.model_validate(jobs[names[one]].request).supervision for one in ("done", "queued")]
    assert asked == ["image-variation", "auto"]
    assert b"30.0" in client.artefact(names["done"], "metrics.json")
    assert client.upload(names["upload"]).state == "committed"
    assert client.append(names["open"], b"56789", 5).offset == 10


@pytest.mark.slow
def test_jobs_in_flight_finish(data, names) -> None:
    service = Deployment(data, postgresql=False, dead_s=2.0)
    try:
        service.start("api")
        service.start("a")
        with ServiceClient.at(service.address) as client:
            wait_for(lambda: finished(client, names["running"]) and finished(client, names["queued"]))
        counts = [read_trace(data / "jobs" / names[one]) for one in ("running", "queued")]
        assert [(count["completed"], count["repeated"], count["missing"]) for count in counts] == [(1, 0, 0)] * 2
        assert service.dead() == []
    finally:
        service.close()


def finished(client: ServiceClient, job_id: str) -> bool:
    try:
        return client.job(job_id).status == "done"
    except Exception:  # noqa: BLE001 the service is starting
        return False


def test_a_folder_is_migrated_once(data, client) -> None:
    with closing(sqlite3.connect(data / "catalogue.sqlite")) as catalogue:
        assert catalogue.execute("SELECT number FROM catalogue_format").fetchall() == [(FORMAT,)]
        catalogue.execute("UPDATE entries SET request = replace(request, 'image-variation', 'variation')")
        catalogue.commit()
    Store(ServiceSettings(data=data)).close()
    with closing(sqlite3.connect(data / "catalogue.sqlite")) as catalogue:
        query = "SELECT count(*) FROM entries WHERE request LIKE '%\"variation\"%'"
        assert catalogue.execute(query).fetchone() == (2,)


def test_a_newer_folder_is_refused_by_name(data) -> None:
    Store(ServiceSettings(data=data)).close()
    with closing(sqlite3.connect(data / "catalogue.sqlite")) as catalogue:
        catalogue.execute("UPDATE catalogue_format SET number = ?", (FORMAT + 1,))
        catalogue.commit()
    with pytest.raises(DatabaseError, match=rf"^{data}: found its format to be {FORMAT + 1}, of a later version"):
        create_app(ServiceSettings(data=data))
    refused = CliRunner().invoke(cli, ["serve", "--data", str(data), "--port", "0"])
    assert isinstance(refused.exception, DatabaseError)
