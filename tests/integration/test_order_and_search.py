"""Lists as an operator needs them: searched, labelled, in the order of the work, with places and expected times."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from datetime import datetime
from pathlib import Path

import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient
from maintenance.postgresql import Postgresql, PostgresqlMissingError

from rigs.toml import catalog_rig, dump_rig
from server.app import create_app
from server.cli.main import cli
from server.client import RefusedError, ServiceClient
from server.schemas.captures import Labels
from server.schemas.job_types import JOB_TYPES, JobBase, ReconstructRequest
from server.schemas.jobs import Job
from server.schemas.progress import Progress
from server.services.services import Services
from server.settings import ServiceSettings
from server.store.tables import Entry

CAPTURE = "c20260101-000000-00000001"
LOOPBACK = "http://127.0.0.1"
SEARCHED = ("plain", "50 % off", "a_b", "axb", "back\\slash", "Lüfter", "FAN 'one'")


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    settings = ServiceSettings(data=tmp_path, locks=tmp_path / "locks")
    with TestClient(create_app(settings), base_url=LOOPBACK) as client:
        yield client


@pytest.fixture
def client(http: TestClient) -> ServiceClient:
    capture_in(http)
    return ServiceClient(http)


@pytest.fixture
def services(http: TestClient) -> Services:
    return http.app.state.services  # type: ignore[attr-defined]


def capture_in(http: TestClient, capture_id: str = CAPTURE, **more: str | None) -> None:
    """Keep a capture that needs no worker."""
    services: Services = http.app.state.services  # type: ignore[attr-defined]
    entry = Entry(capture_id, "capture", "import", "2026-01-01", {}, **({"rig": "lab3x3"} | more))  # type: ignore[arg-type]
    services.store.entries.add(entry)
    services.store.events.tell(entry.id, "new", "done", {})
    recording = services.store.folder.recording(entry.id)
    recording.mkdir()
    (recording / "rig.toml").write_text(dump_rig(catalog_rig("lab3x3")))


def verify(**fields: object) -> JobBase:
    return JOB_TYPES["verify"].model_validate({"type": "verify", "capture": CAPTURE, **fields})


def finished(services: Services, number: int, kind: str, seconds: dict[str, float], **request: object) -> None:
    """Keep a job that was done."""
    asked = JOB_TYPES[kind].model_validate({"type": kind, "capture": CAPTURE, **request})
    kept = asked.model_dump(exclude={"name", "priority"})
    progress = Progress(seconds=seconds, fraction=1.0).model_dump()
    entry_id = f"j20260101-000000-{number:08x}"
    services.store.entries.add(
        Entry(entry_id, "job", kind, "2026-01-01", kept, queue="tasks", progress=progress, told="done")
    )


def set_running(tmp_path: Path, job: Job) -> None:
    """Let the engine know a job as one that a worker has taken."""
    with closing(sqlite3.connect(tmp_path / "dbos.sqlite")) as engine:
        engine.execute("UPDATE workflow_status SET status = 'PENDING' WHERE workflow_uuid = ?", (job.id,))
        engine.commit()


def in_seconds(services: Services, moment: str | None) -> float | None:
    """Return how far off a moment is."""
    return None if moment is None else datetime.fromisoformat(moment).timestamp() - services.store.clock()


def near(value: float) -> object:
    return pytest.approx(value, abs=3)


def queued(client: ServiceClient) -> list[Job]:
    return client.jobs(order="work", status="queued")


def test_a_queued_job_says_its_place(client: ServiceClient, services: Services, tmp_path: Path) -> None:
    first, second, urgent = client.submit_all([verify(), verify(), verify(priority=2)])
    other = client.submit(ReconstructRequest(capture=CAPTURE))
    services.queue.close()  # all of the batch are in the queue
    assert next(iter(queued(client))).id == urgent.id
    assert [client.job(one.id).position for one in (urgent, first, second, other)] == [1, 2, 3, 1]
    client.prioritise(second.id, 3)
    assert [client.job(one.id).position for one in (urgent, second, first)] == [1, 2, 3]
    set_running(tmp_path, urgent)
    assert [client.job(one.id).position for one in (urgent, second, first)] == [None, 1, 2]
    client.cancel(second.id)
    assert [client.job(one.id).position for one in (second, first)] == [None, 1]


def test_nothing_is_made_up(client: ServiceClient, services: Services) -> None:
    job = client.submit(verify())
    assert (job.position, job.expected_begin, job.expected_end) == (1, None, None)  # nobody works
    services.store.workers.enter("w", ["tasks"])
    assert in_seconds(services, client.job(job.id).expected_begin) == near(0)
    assert client.job(job.id).expected_end is None  # no verification was ever done
    assert client.job(client.submit(verify()).id).expected_begin is None  # so nobody knows when the next begins


def test_times_follow_from_earlier_jobs_and_the_workers(client: ServiceClient, services: Services) -> None:
    for number, seconds in enumerate((80.0, 100.0, 900.0)):
        finished(services, number, "verify", {"verify": seconds})
    jobs = client.submit_all([verify() for _ in range(3)])
    services.queue.close()
    services.store.workers.enter("a", ["tasks"])
    shown = [client.job(job.id) for job in jobs]
    assert [in_seconds(services, job.expected_begin) for job in shown] == [near(0), near(100), near(200)]
    assert [in_seconds(services, job.expected_end) for job in shown] == [near(100), near(200), near(300)]
    services.store.workers.enter("b", ["reconstructions", "tasks"])
    assert [in_seconds(services, job.expected_end) for job in client.jobs(order="work")[:3]] == [
        near(100),
        near(100),
        near(200),
    ]


def test_a_running_job_ends_as_its_share_and_its_stages_say(
    client: ServiceClient, services: Services, tmp_path: Path
) -> None:
    usual = {"plan": 2.0, "poses": 3.0, "images": 10.0, "points": 20.0, "train": 100.0, "report": 30.0}
    finished(services, 1, "reconstruct", usual, steps=500)
    finished(services, 2, "reconstruct", {name: 9 * s for name, s in usual.items()}, steps=9000)
    services.store.workers.enter("w", ["reconstructions"])
    job, after = client.submit_all([ReconstructRequest(capture=CAPTURE, steps=500) for _ in range(2)])
    services.queue.close()
    set_running(tmp_path, job)
    seconds = {"plan": 2.0, "poses": 3.0, "images": 10.0}
    report = Progress(stage="points", fraction=0.25, seconds=seconds | {"points": 10.0})
    services.store.events.progress(job.id, report.model_dump())
    left = 30.0 + 100.0 + 30.0  # the stage goes at half the usual speed
    assert in_seconds(services, client.job(job.id).expected_end) == near(left)
    assert in_seconds(services, client.job(after.id).expected_begin) == near(left)
    assert in_seconds(services, client.job(after.id).expected_end) == near(left + sum(usual.values()))


def test_a_budget_is_known_before_any_job_was_done(client: ServiceClient, services: Services, tmp_path: Path) -> None:
    services.store.workers.enter("w", ["reconstructions"])
    job = client.submit(ReconstructRequest(capture=CAPTURE, budget_s=300))
    assert in_seconds(services, client.job(job.id).expected_end) == near(300)
    set_running(tmp_path, job)
    report = Progress(stage="train", fraction=0.4, seconds={"plan": 10.0, "train": 90.0})
    services.store.events.progress(job.id, report.model_dump())
    assert in_seconds(services, client.job(job.id).expected_end) == near(200)
    finished(services, 1, "reconstruct", {"train": 5.0, "report": 40.0}, budget_s=50)
    assert in_seconds(services, client.job(job.id).expected_end) == near(240)


def test_pages_in_the_order_of_the_work(client: ServiceClient, services: Services, http: TestClient) -> None:
    ended = [client.cancel(client.submit(verify()).id).id for _ in range(4)]
    last, first, middle = (client.submit(verify(priority=p)).id for p in (300, 100, 200))
    services.announcer.look()
    wanted = [first, middle, last, *reversed(ended)]
    assert [job.id for job in client.jobs(order="work")] == wanted
    assert [job.id for job in client.jobs()] == [middle, first, last, *reversed(ended)]
    for limit in (1, 2, 3, 5):
        found, cursor = [], None
        while cursor is not None or not found:
            asked = {"order": "work", "limit": limit} | ({"cursor": cursor} if cursor else {})
            page = http.get("/v1/jobs", params=asked).json()
            found += [one["id"] for one in page["items"]]
            cursor = page["next"]
        assert found == wanted
    assert [job.id for job in client.jobs(order="work", status="cancelled", limit=2)] == wanted[3:5]
    with pytest.raises(RefusedError, match="the cursor of another order"):
        client.jobs(order="work", cursor=first)


def test_a_cursor_outlives_its_job(client: ServiceClient, services: Services, http: TestClient) -> None:
    ids = [client.submit(verify()).id for _ in range(4)]
    page = http.get("/v1/jobs", params={"order": "work", "limit": 2}).json()
    client.cancel(ids[1])
    services.announcer.look()
    client.delete_job(ids[1])
    rest = client.jobs(order="work", cursor=page["next"])
    assert [job.id for job in rest] == ids[2:]


def test_labels_are_changed_one_by_one(client: ServiceClient, http: TestClient) -> None:
    job = client.submit(verify(name="first"))
    for path, kind in ((f"/v1/jobs/{job.id}", "jobs"), (f"/v1/captures/{CAPTURE}", "captures")):
        http.patch(path, json={"name": "fan"})
        changed = http.patch(path, json={"note": "two lines,\n\tone tab"}).json()
        assert (changed["name"], changed["note"]) == ("fan", "two lines,\n\tone tab")
        assert http.get(f"/v1/{kind}").json()["items"][0]["note"] == "two lines,\n\tone tab"
        assert http.patch(path, json={}).json() == http.get(path).json()
        assert http.patch(path, json={"note": None}).json()["note"] is None
        for wrong in ({"note": "x" * 2001}, {"note": ""}, {"note": "a\u202eb"}, {"note": "a\rb"}, {"colour": "red"}):
            assert http.patch(path, json=wrong).status_code == 422, wrong
        assert http.patch(path, json={"note": "x" * 2000}).status_code == 200
    assert http.patch("/v1/jobs/j20260101-000000-0000000f", json={}).status_code == 404
    assert http.patch(f"/v1/jobs/{CAPTURE}", json={"name": "x"}).status_code == 404


def test_a_note_is_in_a_backup(tmp_path: Path) -> None:
    data, kept = tmp_path / "data", tmp_path / "kept"
    with TestClient(create_app(ServiceSettings(data=data)), base_url=LOOPBACK) as http:
        capture_in(http)
        ServiceClient(http).label_capture(CAPTURE, Labels(note="half speed"))
        assert CliRunner().invoke(cli, ["backup", "--data", str(data), "--out", str(kept)]).exit_code == 0
        ServiceClient(http).label_capture(CAPTURE, Labels(note=None))
    assert CliRunner().invoke(cli, ["restore", str(kept), "--data", str(data)]).exit_code == 0
    with TestClient(create_app(ServiceSettings(data=data)), base_url=LOOPBACK) as http:
        assert ServiceClient(http).capture(CAPTURE).note == "half speed"


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def searched(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestClient]:
    """A service on either database."""
    if request.param == "sqlite":
        with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url=LOOPBACK) as http:
            yield http
        return
    try:
        server = Postgresql()
    except PostgresqlMissingError as error:
        pytest.skip(str(error))
    try:
        for name, value in server.environment.items():
            monkeypatch.setenv(name, value)
        settings = ServiceSettings(data=tmp_path)
        with TestClient(create_app(settings), base_url=LOOPBACK) as http:
            yield http
    finally:
        server.close()


def test_search(searched: TestClient) -> None:
    """By name, note, id and rig, taken literally, in capitals or not; jobs also by their capture."""
    client = ServiceClient(searched)
    for number, name in enumerate(SEARCHED):
        capture_in(searched, f"c20260101-000000-{number + 1:08x}", name=name, rig="lab3x3" if number else "Other")
    client.label_capture("c20260101-000000-00000001", Labels(note="first line\nblurred"))

    def found(q: str, **more: str | int) -> list[str | None]:
        return [one.name for one in client.captures(q=q, **more)]

    assert found("%") == ["50 % off"]
    assert found("_") == ["a_b"]
    assert found("A_B") == ["a_b"]
    assert found("\\") == ["back\\slash"]
    assert found("lÜFTER") == ["Lüfter"]
    assert found("'one'") == ["FAN 'one'"]
    assert found("BLURRED") == found("other") == found("0000-00000001") == ["plain"]
    assert found("nowhere") == []
    assert found("lab3x3", limit=1) == ["FAN 'one'"]
    cursor = searched.get("/v1/captures", params={"q": "lab3x3", "limit": 4}).json()["next"]
    assert found("lab3x3", cursor=cursor) == ["a_b", "50 % off"]
    by_name = client.submit(verify(name="night run"))
    of_fan = client.submit(verify(capture="c20260101-000000-00000007"))
    client.label_job(by_name.id, Labels(note="again"))
    assert [job.id for job in client.jobs(q="AGAIN")] == [job.id for job in client.jobs(q="night")] == [by_name.id]
    assert [job.id for job in client.jobs(q="fan", order="work")] == [of_fan.id]
    assert [job.id for job in client.jobs(q="00000007")] == [of_fan.id]
    assert searched.get("/v1/jobs", params={"q": ""}).status_code == 422
    assert searched.get("/v1/jobs", params={"q": "x" * 81}).status_code == 422
