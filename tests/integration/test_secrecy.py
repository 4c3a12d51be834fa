"""Keeps secrets from other users and viewers, and closes connections that send nothing."""

import json
import socket
import stat
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy.exc import OperationalError

from acquisition.errors import DiskError
from server import hosting
from server.app import create_app
from server.middleware.problems import problem_of
from server.settings import ServiceSettings
from server.store.tables import Entry
from server.work.reporter import Reporter


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    with TestClient(create_app(ServiceSettings(data=tmp_path / "data")), base_url="http://127.0.0.1") as client:
        yield client


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_the_data_folder_is_its_owners_alone(http: TestClient, tmp_path: Path) -> None:
    assert mode(tmp_path / "data") == 0o700
    databases = list((tmp_path / "data").glob("*.sqlite*"))
    assert len(databases) >= 2
    assert {mode(path) for path in databases} == {0o600}


def test_a_folder_that_was_open_is_closed(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir(mode=0o755)
    create_app(ServiceSettings(data=tmp_path / "data")).state.services.store.close()
    assert mode(tmp_path / "data") == 0o700


def test_messages_and_logs_carry_no_path_of_the_server(http: TestClient, tmp_path: Path) -> None:
    store = http.app.state.services.store  # type: ignore[attr-defined]
    entry = Entry(
        store.entries.dated_id("j"),
        "job",
        "verify",
        store.entries.now(),
        {"type": "verify", "capture": "c"},
        told="failed",
    )
    store.entries.add(entry)
    reporter = Reporter(store, entry.id, "verify")
    reporter(0.5, f"read {tmp_path}/data/captures/c1/cam00.dat")
    reporter.close(DiskError("found no space left", "some", where=tmp_path / "data" / "jobs"))
    store.folder.entry(entry.id)
    store.folder.log(entry.id).write_text(f"{tmp_path}/data/jobs/x: torn\n")
    said = http.get(f"/v1/jobs/{entry.id}").text + http.get(f"/v1/jobs/{entry.id}/log").text
    assert str(tmp_path) not in said
    assert "jobs: found no space left" in said
    assert "captures/c1/cam00.dat" in said
    assert "jobs/x: torn" in said


def test_a_lost_database_is_named_without_its_path(http: TestClient, tmp_path: Path) -> None:
    (tmp_path / "data" / "dbos.sqlite").unlink()
    said = http.get("/v1/readyz").text
    assert "dbos.sqlite gone" in said
    assert str(tmp_path) not in said


def test_a_database_that_does_not_answer_is_not_named(caplog: pytest.LogCaptureFixture) -> None:
    reason = Exception('connection to server at "10.0.0.7", port 5432 failed')
    answer = problem_of(OperationalError("SELECT 1", {}, reason))
    assert answer.status_code == 503
    assert "10.0.0.7" not in bytes(answer.body).decode()
    assert "10.0.0.7" in caplog.text


def test_a_viewer_sees_the_host_of_a_webhook_and_no_more(http: TestClient) -> None:
    store = http.app.state.services.store  # type: ignore[attr-defined]
    webhook = store.webhooks.add("https://hooks.example/T0/secret?key=1", ["done"])
    tokens = {role: store.tokens.add(role, role) for role in ("viewer", "operator")}
    time.sleep(2.1)  # the service reads its tokens every two seconds
    for role, wanted in (
        ("viewer", "https://hooks.example/..."),
        ("operator", "https://hooks.example/T0/secret?key=1"),
    ):
        headers = {"Authorization": f"Bearer {tokens[role]}"}
        listed = http.get("/v1/webhooks", headers=headers).json()["items"]
        one = http.get(f"/v1/webhooks/{webhook.id}", headers=headers).json()
        assert [listed[0]["url"], one["url"]] == [wanted, wanted]
        assert webhook.secret not in json.dumps([listed, one])


@pytest.fixture
def address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, int]]:
    """A service that grants the head of a request a fifth of a second."""
    monkeypatch.setattr(hosting, "_HEADERS_S", 0.2)
    settings = ServiceSettings(data=tmp_path / "data")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = hosting.server_of(create_app(settings), settings)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        while not server.started:
            time.sleep(0.01)
        yield listener.getsockname()
        server.should_exit = True
        thread.join(20)


@pytest.mark.parametrize("sent", [b"", b"GET / HT", b"GET /v1/healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "])
def test_a_connection_that_sends_no_request_is_closed(address: tuple[str, int], sent: bytes) -> None:
    with socket.create_connection(address) as idle:
        idle.settimeout(10)
        idle.sendall(sent)
        assert idle.recv(1000) == b""


def test_a_slow_request_after_another_is_closed_and_quick_ones_are_served(address: tuple[str, int]) -> None:
    request = b"GET /v1/healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with socket.create_connection(address) as connection:
        connection.settimeout(10)
        for _ in range(8):
            connection.sendall(request)
            answer = b""
            while not answer.endswith(b'{"ok":true}'):
                answer += connection.recv(4000)
            time.sleep(0.05)
        connection.sendall(request[:20])
        assert connection.recv(1000) == b""
