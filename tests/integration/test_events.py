"""Server-Sent Events over a real connection; what happens is written straight into the tables."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI
from maintenance.waiting import wait_for

from server.app import create_app
from server.cli.serve import listening
from server.hosting import server_of
from server.schemas.progress import Progress
from server.services.services import Services
from server.settings import ServiceSettings
from server.store.tables import Entry


@pytest.fixture
def app(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FastAPI:
    app = create_app(ServiceSettings(data=tmp_path))
    monkeypatch.setattr(app.state.services.announcer, "look", lambda: None)  # the tests tell what happens
    return app


@pytest.fixture
def services(app: FastAPI) -> Services:
    return app.state.services


@pytest.fixture
def http(app: FastAPI) -> Iterator[httpx.Client]:
    with listening("127.0.0.1", 0) as listener:
        server = server_of(app, app.state.services.settings)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        limits = httpx.Limits(max_connections=None)
        address = f"http://127.0.0.1:{listener.getsockname()[1]}"
        with httpx.Client(base_url=address, limits=limits, trust_env=False, timeout=20) as client:
            wait_for(lambda: server.started)
            client.server = server  # type: ignore[attr-defined]
            yield client
        server.should_exit = True
        thread.join(20)
        assert not thread.is_alive()


@pytest.fixture
def opened() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def entry(services: Services, told: str = "new", number: int = 1) -> str:
    made = Entry(
        id=f"j20260101-000000-{number:08x}", kind="job", type="verify", created="2026-01-01T00:00:00.000+00:00",
        request={"type": "verify", "capture": "c"}, queue=None, told=told,
    )  # fmt: skip
    services.store.entries.add(made)
    return made.id


def tell(services: Services, entry_id: str, *statuses: str) -> None:
    for status in statuses:
        (found,) = services.store.entries.find([entry_id])
        assert services.store.events.tell(entry_id, found.told, status, {}) is not None


def read(lines: Iterator[str]) -> Iterator[dict[str, str]]:
    fields: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(":")
            fields[name] = value.strip()
        else:
            yield fields
            fields = {}


def test_an_ended_entry_is_told_from_its_beginning(http: httpx.Client, services: Services) -> None:
    job = entry(services)
    tell(services, job, "queued", "running")
    services.store.events.progress(job, Progress(stage="verify", fraction=0.5).model_dump())
    tell(services, job, "failed", "queued", "running", "done")
    answer = http.get(f"/v1/jobs/{job}/events")
    assert answer.headers["content-type"].startswith("text/event-stream")
    found = list(read(iter(answer.text.split("\n")[:-1])))
    assert [one["event"] for one in found] == ["status", "status", "progress", *["status"] * 4]
    events = [json.loads(one["data"]) for one in found]
    assert [str(event["seq"]) for event in events] == [one["id"] for one in found]
    assert events[2]["data"]["fraction"] == 0.5
    assert [event["data"]["status"] for event in events if event["kind"] == "status"][-1] == "done"
    rest = http.get(f"/v1/jobs/{job}/events", headers={"Last-Event-ID": found[-2]["id"]})
    assert [one["id"] for one in read(iter(rest.text.split("\n")[:-1]))] == [found[-1]["id"]]
    assert http.get(f"/v1/jobs/{job}/events", params={"after": found[-1]["id"]}).status_code == 204
    assert http.get("/v1/jobs/j20260101-000000-99999999/events").status_code == 404
    assert http.get(f"/v1/jobs/{job}/events", headers={"Last-Event-ID": "x"}).status_code == 422


def test_a_stream_follows_until_the_entry_ends(http: httpx.Client, services: Services) -> None:
    job, other = entry(services, number=1), entry(services, number=2)
    tell(services, job, "queued")
    with http.stream("GET", f"/v1/jobs/{job}/events") as answer:
        events = read(answer.iter_lines())
        assert json.loads(next(events)["data"])["data"]["status"] == "queued"
        tell(services, other, "queued", "running")
        tell(services, job, "running", "cancelled")
        assert [json.loads(event["data"])["data"]["status"] for event in events] == ["running", "cancelled"]


@pytest.mark.slow
def test_two_hundred_listeners_share_one_reader_of_the_table(
    http: httpx.Client, services: Services, monkeypatch: pytest.MonkeyPatch, opened: ExitStack
) -> None:
    job = entry(services)
    tell(services, job, "queued")
    reads: list[str | None] = []
    after = services.store.events.after

    def counted(seq: int, entry_id: str | None = None, limit: int = 500) -> list:
        reads.append(entry_id)
        return after(seq, entry_id, limit)

    monkeypatch.setattr(services.store.events, "after", counted)
    listeners = [opened.enter_context(socket.create_connection(("127.0.0.1", http.base_url.port))) for _ in range(200)]
    for listener in listeners:
        listener.sendall(b"GET /v1/events?after=0 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        listener.settimeout(20)
    found = [until(listener, b'"queued"') for listener in listeners]
    caught_up = len(reads)
    assert caught_up >= 200  # each has read what was
    for number in range(50):
        services.store.events.progress(job, Progress(stage="verify", fraction=number / 50).model_dump())
    tell(services, job, "running", "done")
    found = [got + until(listener, b'"done"') for listener, got in zip(listeners, found, strict=True)]
    assert {got.count(b"event: progress") for got in found} == {50}
    assert len(reads) - caught_up < 200  # one a look, not one a listener


def until(listener: socket.socket, word: bytes) -> bytes:
    found = b""
    while word not in found:
        part = listener.recv(65536)
        assert part
        found += part
    return found


def test_open_streams_do_not_hold_up_the_end(http: httpx.Client, services: Services) -> None:
    with http.stream("GET", "/v1/events") as answer:
        assert answer.status_code == 200
        http.server.should_exit = True  # type: ignore[attr-defined]
        assert list(answer.iter_lines()) == []


def test_all_events_begin_now_unless_a_number_is_given(http: httpx.Client, services: Services) -> None:
    job = entry(services)
    tell(services, job, "queued", "running")
    with http.stream("GET", "/v1/events") as answer:
        tell(services, job, "done")
        assert json.loads(next(read(answer.iter_lines()))["data"])["data"]["status"] == "done"
