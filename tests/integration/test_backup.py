"""Backups while the service works, restores, and databases that were lost or damaged."""

import json
import shutil
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from fastapi.testclient import TestClient

from server.app import create_app
from server.cli.main import cli
from server.client import ServiceClient
from server.engine import Engine
from server.schemas.captures import CaptureRequest
from server.schemas.uploads import UploadRequest
from server.settings import ServiceSettings
from server.store.files import locked
from server.store.soundness import DatabaseError

DATABASES = ("dbos.sqlite", "catalogue.sqlite")


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return tmp_path / "data"


@pytest.fixture
def opened(data: Path) -> Callable[[], TestClient]:
    """Return a function that opens the service over the data folder, without a worker."""
    return lambda: TestClient(create_app(ServiceSettings(data=data)), base_url="http://127.0.0.1")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(one) for one in arguments])


def one_line(result: Result, *words: str) -> None:
    assert result.exit_code == 1
    text = str(result.exception)
    assert "\n" not in text
    for word in words:
        assert word in text, text


def states(client: ServiceClient) -> dict[str, str]:
    return {one.id: one.status for one in client.captures()}


def test_a_service_at_work_is_backed_up_and_not_restored(opened, data, tmp_path) -> None:
    with opened():
        assert run("backup", "--data", data, "--out", tmp_path / "b").exit_code == 0
        one_line(run("restore", tmp_path / "b", "--data", data), "at work", "stopped")
    for name in DATABASES:
        with sqlite3.connect(tmp_path / "b" / name) as copy:
            assert copy.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_what_came_after_the_backup_is_told(opened, data, tmp_path) -> None:
    with opened() as http:
        client = ServiceClient(http)
        first = client.start_capture("lab3x3", CaptureRequest(ticks=5))
        client.stop_capture(first)
        assert run("backup", "--data", data, "--out", tmp_path / "b").exit_code == 0
        client.delete_capture(first.id)
        second = client.start_capture("lab3x3", CaptureRequest(ticks=5))
    (data / "captures" / second.id).mkdir()
    (data / "rigs" / "lab3x3").mkdir(exist_ok=True)
    (data / "rigs" / "lab3x3" / "mine").write_text("newer")
    result = run("restore", tmp_path / "b", "--data", data)
    assert (result.exit_code, result.exception) == (0, None)
    assert f"1 captures are newer than the backup and have no entry: {second.id}" in result.output
    (replaced,) = data.glob("replaced-*")
    assert {path.name for path in replaced.iterdir()} >= set(DATABASES)
    assert (data / "rigs" / "lab3x3" / "mine").read_text() == "newer"
    with opened() as http:
        assert states(ServiceClient(http)) == {first.id: "cancelled"}


def test_a_backup_made_under_load_is_whole(opened, data, tmp_path) -> None:
    with opened() as http:
        client = ServiceClient(http)
        made: list[str] = []
        enough = threading.Event()

        def write() -> None:
            while not enough.is_set():
                made.append(client.begin_upload(UploadRequest(name="a", bytes=10)).id)

        writer = threading.Thread(target=write)
        writer.start()
        counts = []
        for number in range(3):
            before = len(made)
            assert run("backup", "--data", data, "--out", tmp_path / str(number)).exit_code == 0
            with sqlite3.connect(tmp_path / str(number) / "catalogue.sqlite") as copy:
                counts.append((before, copy.execute("SELECT count(*) FROM uploads").fetchone()[0]))
        enough.set()
        writer.join()
    assert all(before <= count <= len(made) for before, count in counts)


def test_a_lost_engine_database_is_named(opened, data) -> None:
    with opened() as http:
        (data / "dbos.sqlite").unlink()
        answer = http.get("/v1/readyz")
        assert answer.status_code == 503
        assert "found dbos.sqlite gone" in answer.json()["detail"]
        assert "spike4dgs restore" in answer.json()["detail"]


def test_what_had_ended_keeps_its_end_and_the_rest_begins_again(opened, data) -> None:
    with opened() as http:
        client = ServiceClient(http)
        ended = client.start_capture("lab3x3", CaptureRequest(ticks=5))
        client.stop_capture(ended)
        queued = client.start_capture("lab3x3", CaptureRequest(ticks=7))
        services = http.app.state.services  # type: ignore[attr-defined]
        services.announcer.look()
    for path in data.glob("dbos.sqlite*"):
        path.unlink()
    with opened() as http:
        client = ServiceClient(http)
        assert states(client) == {ended.id: "cancelled", queued.id: "queued"}
        assert client.capture(ended.id).status == "cancelled"
        services = http.app.state.services  # type: ignore[attr-defined]
        services.announcer._is_old = lambda entry: True  # a minute has passed
        services.announcer.look()
        engine: Engine = services.engine
        assert engine.known(services.store.entries.find([queued.id])) == {queued.id: "queued"}
        client.delete_capture(ended.id)
        assert states(client) == {queued.id: "queued"}


@pytest.mark.parametrize("name", DATABASES)
def test_a_damaged_database_is_one_line(name, opened, data, tmp_path) -> None:
    with opened():
        pass
    (data / name).write_bytes(b"not a database" * 1000)
    with pytest.raises(DatabaseError, match=rf"found {name} damaged \(file is not a database\).*spike4dgs restore"):
        create_app(ServiceSettings(data=data))
    one_line(run("backup", "--data", data, "--out", tmp_path / "b"), "damaged", name)
    assert not (tmp_path / "b").exists()


def test_a_torn_database_is_found(opened, data) -> None:
    with opened():
        pass
    whole = (data / "catalogue.sqlite").read_bytes()
    (data / "catalogue.sqlite").write_bytes(whole[:4096] + bytes(4096) + whole[8192:])
    with pytest.raises(DatabaseError, match=r"catalogue\.sqlite damaged"):
        create_app(ServiceSettings(data=data))


def test_a_lost_catalogue_is_not_made_anew(opened, data) -> None:
    with opened():
        pass
    (data / "catalogue.sqlite").unlink()
    with pytest.raises(DatabaseError, match=r"found catalogue\.sqlite gone"):
        create_app(ServiceSettings(data=data))
    assert not (data / "catalogue.sqlite").exists()


def test_what_is_no_backup_changes_nothing(opened, data, tmp_path) -> None:
    with opened():
        pass
    before = {name: (data / name).read_bytes() for name in DATABASES}
    one_line(run("restore", tmp_path / "nothing", "--data", data), "found no backup")
    assert run("backup", "--data", data, "--out", tmp_path / "b").exit_code == 0
    one_line(run("backup", "--data", data, "--out", tmp_path / "b"), "a new folder")
    (tmp_path / "b" / "dbos.sqlite").write_bytes(b"torn")
    one_line(run("restore", tmp_path / "b", "--data", data), "dbos.sqlite damaged")
    shutil.copy(data / "dbos.sqlite", tmp_path / "b")
    (tmp_path / "b" / "backup.json").write_text(json.dumps({"format": 2}))
    one_line(run("restore", tmp_path / "b", "--data", data), "format 2, expected 1")
    assert {name: (data / name).read_bytes() for name in DATABASES} == before


def test_a_server_database_is_backed_up_by_its_own_tools(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("SPIKE4DGS_DATABASE", "postgresql://u@localhost/n")
    one_line(run("backup", "--data", tmp_path, "--out", tmp_path / "b"), "pg_dump")
    one_line(run("restore", tmp_path / "b", "--data", tmp_path), "pg_restore")


def test_a_service_does_not_start_during_a_restore(data) -> None:
    data.mkdir()
    with locked(data), pytest.raises(DatabaseError, match="being restored"):
        create_app(ServiceSettings(data=data))


def test_what_is_deleted_while_a_backup_is_made_is_left_out(opened, data, tmp_path, monkeypatch) -> None:
    with opened():
        for name in ("a", "b", "c"):
            (data / "entries" / name / "parts").mkdir(parents=True)
            (data / "entries" / name / "log.txt").write_text(name)
        (data / "entries" / "a" / "x.partial").write_text("half")
        copy = shutil.copy2

        def gone(source: Path, to: Path) -> object:
            shutil.rmtree(data / "entries" / "b", ignore_errors=True)
            return copy(source, to)

        monkeypatch.setattr(shutil, "copy2", gone)
        result = run("backup", "--data", data, "--out", tmp_path / "b")
    assert (result.exit_code, result.exception) == (0, None)
    kept = {str(path.relative_to(tmp_path / "b/entries")) for path in (tmp_path / "b/entries").rglob("*")}
    assert kept == {"a", "a/log.txt", "a/parts", "c", "c/log.txt", "c/parts"}
