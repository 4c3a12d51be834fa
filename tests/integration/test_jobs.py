"""Jobs: batches, keys, priorities, restarts, tasks, artefacts, figures and what is let go of."""

import base64
import hashlib
import io
import json
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for

from rigs.toml import catalog_rig, dump_rig
from server.app import create_app
from server.client import RefusedError, ServiceClient
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.job_types import JOB_TYPES, JobBase, ReconstructRequest
from server.schemas.progress import Progress
from server.services.retention import Retention
from server.services.services import Services
from server.settings import ServiceSettings
from server.store.events import Events
from server.store.tables import Entry

FAKE = (sys.executable, str(Path(__file__).with_name("fake_stage.py")))
LOOPBACK = "http://127.0.0.1"
DAY_S = 24 * 3600


def verify(capture: str, **fields: object) -> JobBase:
    return JOB_TYPES["verify"].model_validate({"type": "verify", "capture": capture, **fields})


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    settings = ServiceSettings(data=tmp_path, locks=tmp_path / "locks")
    with TestClient(create_app(settings), base_url=LOOPBACK) as client:
        yield client


@pytest.fixture
def services(http: TestClient) -> Services:
    return http.app.state.services  # type: ignore[attr-defined]


@pytest.fixture
def imported(services: Services) -> str:
    """A capture that needs no worker."""
    entry = Entry("c20260101-000000-00000001", "capture", "import", "2026-01-01", {}, rig="lab3x3")
    services.store.entries.add(entry)
    services.store.events.tell(entry.id, "new", "done", {})
    recording = services.store.folder.recording(entry.id)
    recording.mkdir()
    (recording / "rig.toml").write_text(dump_rig(catalog_rig("lab3x3")))
    return entry.id


# Without a worker


def test_a_batch_is_all_or_nothing(http: TestClient, imported: str) -> None:
    client = ServiceClient(http)
    made = client.submit_all([verify(imported, name=f"n{number}") for number in range(3)])
    assert [job.name for job in made] == ["n0", "n1", "n2"]
    with pytest.raises(RefusedError, match="cam77"):
        client.submit_all([verify(imported), ReconstructRequest(capture=imported, holdout="cam77")])
    with pytest.raises(RefusedError, match="c20260101-000000-00000009"):
        client.submit_all([verify(imported), verify("c20260101-000000-00000009")])
    assert {job.id for job in client.jobs()} == {job.id for job in made}


def test_a_key_makes_one_job(http: TestClient, imported: str) -> None:
    key = {"Idempotency-Key": "tonight"}
    body = {"type": "verify", "capture": imported}

    def post(_: int) -> str:
        return http.post("/v1/jobs", json=body, headers=key).json()["id"]

    with ThreadPoolExecutor(8) as pool:
        ids = set(pool.map(post, range(16)))
    assert len(ids) == 1
    assert [job["id"] for job in http.get("/v1/jobs").json()["items"]] == list(ids)
    other = http.post("/v1/jobs", json=body | {"name": "x"}, headers=key)
    assert other.status_code == 422
    assert "another request" in other.json()["detail"]


def test_filters_and_pages(http: TestClient, imported: str) -> None:
    client = ServiceClient(http)
    made = client.submit_all([verify(imported, name=f"n{number % 2}") for number in range(7)])
    client.cancel(made[0].id)
    pages, cursor = [], None
    while True:
        page = http.get("/v1/jobs", params={"limit": 3} | ({"cursor": cursor} if cursor else {})).json()
        pages.append([job["id"] for job in page["items"]])
        cursor = page["next"]
        if cursor is None:
            break
    assert [len(page) for page in pages] == [3, 3, 1]
    assert [job for page in pages for job in page] == sorted((job.id for job in made), reverse=True)
    assert {job.name for job in client.jobs(name="n1")} == {"n1"}
    assert [job.id for job in client.jobs(status="cancelled")] == [made[0].id]
    assert len(client.jobs(status="queued", limit=4)) == 4
    assert client.jobs(type="images") == client.jobs(capture="c20260101-000000-00000002") == []
    assert len(client.jobs(rig="lab3x3", capture=imported, type="verify")) == 7
    assert http.get("/v1/jobs", params={"limit": 0}).status_code == 422


def test_a_job_in_use_is_not_deleted(http: TestClient, services: Services, imported: str) -> None:
    run = Entry(
        "j20260101-000000-00000001", "job", "reconstruct", "2026-01-01", {"capture": imported}, capture=imported
    )
    services.store.entries.add(run)
    services.store.events.tell(run.id, "new", "done", {})
    client = ServiceClient(http)
    job = client.submit(JOB_TYPES["evaluate"].model_validate({"type": "evaluate", "job": run.id}))
    with pytest.raises(RefusedError, match=f"in use by {job.id}"):
        client.delete_job(run.id)
    with pytest.raises(RefusedError, match="queued"):
        client.delete_job(job.id)
    client.cancel(job.id)
    wait_for(lambda: services.store.entries.get("job", job.id).told == "cancelled")
    client.delete_job(job.id)
    with pytest.raises(RefusedError, match="no job"):
        client.job(job.id)


def test_long_lists_are_listed(http: TestClient, imported: str) -> None:
    client = ServiceClient(http)
    client.submit_all([verify(imported) for _ in range(120)])
    answer = http.get("/v1/jobs", params={"limit": 1000})
    assert len(answer.json()["items"]) == 120
    assert {job["status"] for job in answer.json()["items"]} == {"queued"}


def test_figures(http: TestClient, services: Services, imported: str) -> None:
    client = ServiceClient(http)
    job = client.submit(verify(imported))
    folder = services.store.folder.recording(imported)
    (folder / "recording.json").write_text("{")  # damaged: counted as nothing
    services.store.events.progress(job.id, Progress(stage="verify", seconds={"verify": 2.5}).model_dump())
    other = Entry("j20260101-000000-00000002", "job", "verify", "2026-01-01", {}, progress={"seconds": {"verify": 4.0}})
    services.store.entries.add(other)
    services.store.events.tell(other.id, "new", "failed", {})
    http.get("/v1/jobs/nothing")
    answer = http.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=")
    lines = set(answer.text.splitlines())
    assert {
        'spike4dgs_queue_depth{queue="tasks",status="queued"} 1.0',
        'spike4dgs_queue_depth{queue="captures-lab3x3",status="running"} 0.0',
        'spike4dgs_stage_seconds_total{stage="verify"} 4.0',
        'spike4dgs_failures_total{type="verify"} 1.0',
        'spike4dgs_workers{queue="tasks"} 0.0',
        'spike4dgs_http_requests_total{method="GET",route="/v1/jobs/{job_id}",status="404"} 1.0',
        'spike4dgs_http_request_seconds_count{method="POST",route="/v1/jobs"} 1.0',
    } <= lines
    services.store.entries.change(other.id, progress={"seconds": {"verify": 6.0}})
    services.store.events.tell(other.id, "failed", "done", {})
    assert 'spike4dgs_stage_seconds_total{stage="verify"} 6.0' in http.get("/metrics").text


def test_what_is_old_is_let_go(http: TestClient, services: Services, imported: str) -> None:
    client = ServiceClient(http)
    old, kept = client.submit_all([verify(imported), verify(imported)])
    for job in (old, kept):
        client.cancel(job.id)
        wait_for(lambda: services.store.entries.get("job", job.id).told == "cancelled")  # noqa: B023
    store = services.store
    Events(store.database, lambda: time.time() - 40 * DAY_S).progress(kept.id, Progress(stage="verify").model_dump())
    store.events.progress(kept.id, Progress(stage="verify").model_dump())
    later = time.time() + 20 * DAY_S
    store.events.tell(kept.id, "cancelled", "failed", {})

    def tidy(days: float | None, now: float) -> None:
        store.clock = lambda: now
        Retention(store, services.engine, services.jobs, services.uploads, days, 7.0).tidy()

    tidy(None, time.time())
    assert [event.kind for event in store.events.after(0, kept.id)].count("progress") == 1
    tidy(None, later)
    assert [event.kind for event in store.events.after(0, kept.id)].count("progress") == 0
    assert {job.id for job in client.jobs()} == {old.id, kept.id}
    Events(store.database, lambda: later).progress(kept.id, Progress(stage="verify").model_dump())
    folder = store.folder.job(old.id)
    assert folder.is_dir()
    tidy(10, later)
    assert [job.id for job in client.jobs()] == [kept.id]
    assert not folder.exists()
    store.entries.remove(kept.id)  # the engine remembers it still
    assert services.engine.ended() == [kept.id]
    tidy(None, later)
    assert services.engine.ended() == []
    assert [capture.id for capture in client.captures()] == [imported]


# With a worker


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("jobs") / "data"


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[ServiceClient]:
    environment = os.environ | {"SPIKE4DGS_STAGE_COMMAND": json.dumps(FAKE), "FAKE_STEPS": "10", "FAKE_STEP_S": "0.01"}
    command = [sys.executable, "-m", "server.cli", "worker", "--data", str(data)]
    with TestClient(create_app(ServiceSettings(data=data)), base_url=LOOPBACK) as http:
        worker = subprocess.Popen(command, env=environment)
        service = ServiceClient(http)
        wait_for(lambda: service.checks()["worker"].ok)
        yield service
        worker.terminate()
        assert worker.wait(20) == 0


@pytest.fixture(scope="module")
def capture(client: ServiceClient) -> Capture:
    made = client.start_capture("lab3x3", CaptureRequest(ticks=40))
    wait_for(lambda: client.capture(made.id).status == "done")
    return client.capture(made.id)


@pytest.mark.slow
def test_the_lower_priority_number_comes_first(client: ServiceClient, data: Path, capture: Capture) -> None:
    first = client.submit(ReconstructRequest(capture=capture.id, priority=1))  # keeps the worker busy
    late, soon, moved = client.submit_all(
        [ReconstructRequest(capture=capture.id, priority=priority) for priority in (300, 50, 500)]
    )
    assert client.prioritise(moved.id, 10).priority == 10
    jobs = [first.id, moved.id, soon.id, late.id]
    wait_for(lambda: all(client.job(job).status == "done" for job in jobs))
    planned = {job: (data / "jobs" / job / "run" / "plan.done").stat().st_mtime_ns for job in jobs}
    assert sorted(jobs, key=planned.__getitem__) == jobs
    with pytest.raises(RefusedError, match="done, expected it queued"):
        client.prioritise(first.id, 5)


@pytest.fixture(scope="module")
def done(client: ServiceClient, capture: Capture) -> str:
    job = client.submit(ReconstructRequest(capture=capture.id))
    wait_for(lambda: client.job(job.id).status == "done")
    return job.id


def stages(client: ServiceClient, job: str) -> list[str]:
    return [line.split()[2] for line in client.log(job).splitlines() if line.startswith("arguments")]


def test_a_restart_repeats_nothing_before_its_stage(client: ServiceClient, done: str) -> None:
    before = stages(client, done)
    steps = client.steps(done)
    assert [(step.stage, step.status) for step in steps] == [(stage, "done") for stage in before]
    assert all(step.seconds is not None for step in steps)
    client.restart(done, "train")
    wait_for(lambda: client.job(done).status == "done")
    assert stages(client, done) == [*before, "train", "report"]
    again = [line for line in client.log(done).splitlines() if "--again" in line]
    assert len(again) == 1
    assert "--stage train --again 1" in again[0]
    assert client._http.post(f"/v1/jobs/{done}/restart", json={"stage": "crystal"}).status_code == 422


def test_artefacts_prove_themselves(client: ServiceClient, done: str) -> None:
    http = client._http
    address = f"/v1/jobs/{done}/artefacts/report.html"
    whole = http.get(address)
    sha256 = hashlib.sha256(whole.content)
    tag, digest = f'"{sha256.hexdigest()}"', f"sha-256=:{base64.b64encode(sha256.digest()).decode()}:"
    assert (whole.headers["ETag"], whole.headers["Repr-Digest"]) == (tag, digest)
    assert whole.headers["Content-Digest"] == digest
    head = http.head(address)
    assert (head.status_code, head.content, head.headers["Content-Length"]) == (200, b"", str(len(whole.content)))
    for known in (tag, f'"x", W/{tag}', "*"):
        same = http.get(address, headers={"If-None-Match": known})
        assert (same.status_code, same.content, same.headers["ETag"]) == (304, b"", tag)
    assert http.get(address, headers={"If-None-Match": '"x"'}).status_code == 200
    part = http.get(address, headers={"Range": "bytes=1-5", "If-Range": tag})
    assert (part.status_code, part.text, part.headers["Repr-Digest"]) == (206, "title", digest)
    assert "Content-Digest" not in part.headers
    assert http.get(address, headers={"Range": "bytes=1-5", "If-Range": '"x"'}).status_code == 200
    assert http.get(address, headers={"Range": "bytes=9999-"}).status_code == 416


def test_the_archive_and_the_thumbnail(client: ServiceClient, capture: Capture, done: str) -> None:
    archive = client.archive(done)
    with zipfile.ZipFile(io.BytesIO(archive)) as found:
        assert found.testzip() is None
        names = {one.name for one in client.artefacts(done)}
        assert set(found.namelist()) == {f"{done}/{name}" for name in names}
        assert found.read(f"{done}/metrics.json") == client.artefact(done, "metrics.json")
    assert "thumbnails/render_000120.png" in names
    assert client.thumbnail(done) == b"\x89PNG"
    job = client.submit(verify(capture.id))
    with pytest.raises(RefusedError, match="no thumbnail"):
        client.thumbnail(job.id)


def test_a_preview_is_what_the_training_drew_last(client: ServiceClient, data: Path, done: str) -> None:
    assert client.job(done).preview is None
    with pytest.raises(RefusedError, match="no preview"):
        client.job_preview(done)
    run = data / "jobs" / done / "run"
    (run / "preview.png").write_bytes(b"\x89PNG first")
    (run / "preview.json").write_text('{"camera": "cam11", "steps": 40}')
    client.restart(done, "report")
    wait_for(lambda: client.job(done).status == "done")
    told = client.job(done).preview
    assert told is not None
    assert (told.camera, told.steps) == ("cam11", 40)
    assert told.at == pytest.approx((run / "preview.json").stat().st_mtime)
    assert next(job for job in client.jobs() if job.id == done).preview == told
    assert client.job_preview(done) == b"\x89PNG first"
    found = client._http.get(f"/v1/jobs/{done}/preview?of=1")
    assert (found.headers["Content-Type"], found.headers["Cache-Control"]) == ("image/png", "no-cache")
    known = {"If-None-Match": found.headers["ETag"]}
    assert client._http.get(f"/v1/jobs/{done}/preview", headers=known).status_code == 304
    (run / "preview.png").write_bytes(b"\x89PNG second")
    assert client._http.get(f"/v1/jobs/{done}/preview", headers=known).content == b"\x89PNG second"
    assert "preview.png" not in {one.name for one in client.artefacts(done)}  # the thumbnails show what it became


def test_a_job_that_follows_begins_with_its_capture(client: ServiceClient) -> None:
    capture = client.start_capture("lab3x3", CaptureRequest(until_stopped=True))
    with pytest.raises(RefusedError, match="cam77"):
        client.submit(ReconstructRequest(capture=capture.id, follow=True, holdout="cam77"))
    with pytest.raises(RefusedError, match=f"found capture {capture.id}"):
        client.submit(ReconstructRequest(capture=capture.id))
    job = client.submit(ReconstructRequest(capture=capture.id, follow=True, holdout="cam11"))
    wait_for(lambda: client.job(job.id).stage == "plan")  # the looks are played: they end at once
    assert client.capture(capture.id).status == "running"
    assert client.job(job.id).seconds["follow"] >= 0
    client.stop_capture(capture)
    wait_for(lambda: client.job(job.id).status == "done")
    assert [step.stage for step in client.steps(job.id)][:2] == ["follow", "plan"]
    assert "--stage follow" in client.log(job.id)
    assert "--follow" not in client.log(job.id)
    both = {"capture": capture.id, "follow": True, "from_tick": 3}
    assert client._http.post("/v1/jobs", json=both).status_code == 422


@pytest.mark.parametrize("kind", ["verify", "check-rig"])
def test_an_answer_of_no_is_an_answer(client: ServiceClient, capture: Capture, kind: str) -> None:
    job = client.submit(JOB_TYPES[kind].model_validate({"type": kind, "capture": capture.id}))
    wait_for(lambda: client.job(job.id).status not in ("queued", "running"))
    assert client.job(job.id).status == "done"
    answer = json.loads(client.artefact(job.id, "result.json"))
    assert (answer["asked"], answer["sound"]) == (kind, False)


def test_a_capture_is_told_to_save_and_to_stop(client: ServiceClient, data: Path) -> None:
    capture = client.start_capture("lab3x3", CaptureRequest(until_stopped=True, pre_trigger_ms=20))
    wait_for(lambda: client.capture(capture.id).message == "armed")
    client.save_capture(capture)
    wait_for(lambda: client.capture(capture.id).message == "saved")
    assert client.stop_capture(capture).status == "running"
    events = list(client.capture_events(capture.id))
    assert events[-1].data.status == client.capture(capture.id).status == "done"
    assert json.loads((data / "captures" / capture.id / "recording.json").read_text()) == {"saved": True}
    with pytest.raises(RefusedError, match="done, expected it recording"):
        client.stop_capture(capture)


def test_deleting_leaves_nothing(client: ServiceClient, data: Path) -> None:
    capture = client.start_capture("lab3x3", CaptureRequest(ticks=40))
    wait_for(lambda: client.capture(capture.id).status == "done")
    job = client.submit(verify(capture.id))
    wait_for(lambda: client.job(job.id).status == "done")
    wait_for(lambda: not _refused(lambda: client.delete_job(job.id)))
    wait_for(lambda: not _refused(lambda: client.delete_capture(capture.id)))
    assert [path for path in data.rglob("*") if job.id in path.name or capture.id in path.name] == []


def _refused(call: Callable[[], None]) -> bool:
    try:
        call()
    except RefusedError:
        return True
    return False


def test_a_job_that_the_engine_has_forgotten_is_resumed(http: TestClient, services: Services, imported: str) -> None:
    client = ServiceClient(http)
    job = client.submit(verify(imported))
    client.cancel(job.id)
    wait_for(lambda: services.store.entries.get("job", job.id).told == "cancelled")
    services.engine.forget(job.id)
    assert client.job(job.id).status == "cancelled"
    assert client.resume(job.id).status == "queued"
    assert client.cancel(job.id).status == "cancelled"
