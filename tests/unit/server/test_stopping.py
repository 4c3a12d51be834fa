"""Orders to stop, to move and to delete, without a worker: what they do to an entry, and who hears of them first."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
import uvicorn
from fastapi.testclient import TestClient
from sqlalchemy.exc import OperationalError

from server import hosting
from server.app import create_app
from server.engine import TASKS, capture_queue
from server.services.services import Services
from server.settings import ServiceSettings
from server.store.tables import Entry
from server.work.keeper import Keeper

RIG = "lab3x3"


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as client:
        yield client


@pytest.fixture
def services(http: TestClient) -> Services:
    return http.app.state.services  # type: ignore[attr-defined]


def asked_for(http: TestClient) -> str:
    return http.post(f"/v1/rigs/{RIG}/captures", json={"until_stopped": True}).json()["id"]


def stopped(http: TestClient, capture_id: str) -> tuple[str, str, str | None]:
    assert http.post(f"/v1/rigs/{RIG}/captures/{capture_id}/stop").is_success
    shown = http.get(f"/v1/captures/{capture_id}").json()
    return shown["status"], shown["message"], shown["error"]


def test_a_capture_that_nobody_took_up_is_cancelled_and_says_so(http: TestClient) -> None:
    end = stopped(http, asked_for(http))
    assert end == ("cancelled", "stopped before it began, so nothing was kept", None)
    assert http.get(f"/v1/rigs/{RIG}").json()["busy"] is None


def test_a_capture_that_a_dead_worker_began_is_left_to_the_next_one(http: TestClient, services: Services) -> None:
    capture_id = asked_for(http)
    services.store.folder.begun(capture_id).touch()  # its worker died, and it was queued again
    assert stopped(http, capture_id)[0] == "queued"
    assert (services.store.folder.entry(capture_id) / "stop").exists()


def test_a_capture_that_was_kept_and_not_queued_stays_stopped(http: TestClient, services: Services) -> None:
    entries = services.store.entries
    asked, places = {"until_stopped": True}, {"rig": RIG, "queue": capture_queue(RIG)}
    entry = Entry(entries.dated_id("c"), "capture", "record", "2026-01-01T00:00:00+00:00", asked, **places)
    entries.add(entry)  # and then its process died
    assert stopped(http, entry.id)[0] == "cancelled"
    services.announcer.look()
    assert http.get(f"/v1/captures/{entry.id}").json()["status"] == "cancelled"


def test_a_job_deleted_before_it_is_moved_is_not_found(
    http: TestClient, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    entries, queue = services.store.entries, services.queue
    asked = {"type": "verify", "capture": "c"}
    entry = Entry(entries.dated_id("j"), "job", "verify", entries.now(), asked, queue=TASKS)
    queue.add(entry)
    move = queue.prioritise

    def deleted_first(moved: Entry, priority: int) -> None:
        queue.remove(moved)
        move(moved, priority)

    monkeypatch.setattr(queue, "prioritise", deleted_first)
    answer = http.put(f"/v1/jobs/{entry.id}/priority", json={"priority": 5})
    assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")


def test_the_worker_is_told_to_stop_before_downloads_are_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []

    async def wait(server: uvicorn.Server, sockets: object = None) -> None:
        order.append("downloads")

    keeper = Keeper(["true"], grace_s=1)
    monkeypatch.setattr(keeper, "stop", lambda: order.append("worker"))
    monkeypatch.setattr(hosting, "configure_logs", lambda settings: None)
    monkeypatch.setattr(uvicorn.Server, "shutdown", wait)
    settings = ServiceSettings(data=tmp_path)
    app = create_app(settings, keeper)
    asyncio.run(hosting.server_of(app, settings).shutdown())
    app.state.services.engine.close()
    app.state.services.store.close()
    assert order == ["worker", "downloads"]


@pytest.mark.parametrize("path", ["captures", "preflight", "look"])
def test_a_request_that_comes_twice_at_once_has_one_answer(
    http: TestClient, services: Services, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def post() -> tuple[int, str]:
        body = {"ticks": 5} if path == "captures" else {}
        answer = http.post(f"/v1/rigs/{RIG}/{path}", json=body, headers={"Idempotency-Key": "once"})
        return answer.status_code, answer.json()["id"]

    first = post()
    once = services.queue.once
    monkeypatch.setattr(services.queue, "once", lambda *asked: (once(*asked)[0], False))  # both looked, then both began
    assert post() == first
    kind = "captures" if path == "captures" else "jobs"
    assert [one["id"] for one in http.get(f"/v1/{kind}").json()["items"]] == [first[1]]
    assert kind == "captures" or services.store.folder.job(first[1]).exists()


def test_a_recording_has_left_its_place_before_its_entry_goes(
    http: TestClient, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture_id, store = asked_for(http), services.store
    stopped(http, capture_id)
    recording = store.folder.recording(capture_id)
    recording.mkdir()
    remove = store.entries.remove

    def removed(entry_id: str) -> None:
        assert not recording.exists()
        remove(entry_id)

    def refused(entry_id: str) -> None:
        raise OperationalError("DELETE", {}, Exception("database is locked"))

    monkeypatch.setattr(store.entries, "remove", refused)
    assert http.delete(f"/v1/captures/{capture_id}").status_code == 503
    assert recording.exists()
    monkeypatch.setattr(store.entries, "remove", removed)
    assert http.delete(f"/v1/captures/{capture_id}").status_code == 204
    assert http.get(f"/v1/captures/{capture_id}").status_code == 404
    assert not recording.exists()
