"""The service over REST, with a real worker whose stages are played by fake_stage.py."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for
from sqlalchemy import event

from server.app import create_app
from server.client import RefusedError, ServiceClient
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.job_types import ReconstructRequest
from server.settings import ServiceSettings
from server.store.files import is_locked
from server.store.workers import Workers

FAKE = (sys.executable, str(Path(__file__).with_name("fake_stage.py")))
LOOPBACK = "http://127.0.0.1"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("service") / "data"


@pytest.fixture(scope="module")
def http(data: Path) -> Iterator[TestClient]:
    with TestClient(create_app(ServiceSettings(data=data)), base_url=LOOPBACK) as client:
        yield client


@pytest.fixture(scope="module")
def client(http: TestClient, data: Path) -> Iterator[ServiceClient]:
    """A client of a service that has a worker."""
    environment = os.environ | {"SPIKE4DGS_STAGE_COMMAND": json.dumps(FAKE), "FAKE_STEPS": "100", "FAKE_STEP_S": "0.01"}
    worker = subprocess.Popen(
        [sys.executable, "-m", "server.cli", "worker", "--data", data],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    )
    service = ServiceClient(http)
    wait_for(lambda: service.checks()["worker"].ok)
    yield service
    worker.terminate()
    assert "Traceback" not in worker.communicate(timeout=20)[1]
    assert worker.returncode == 0


@pytest.fixture(scope="module")
def capture(client: ServiceClient) -> Capture:
    made = client.start_capture("lab3x3", CaptureRequest(ticks=40, name="forty"))
    wait_for(lambda: client.capture(made.id).status == "done")
    return client.capture(made.id)


def assert_problem(response, status: int, *words: str) -> None:
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["status"] == status
    assert "\n" not in response.json()["detail"]
    for word in words:
        assert word in response.json()["detail"]


# Without a worker


@pytest.mark.parametrize(
    ("method", "path", "status", "word"),
    [
        ("GET", "/v1/rigs/lab9x9", 404, "lab3x3"),
        ("GET", "/v1/captures/c20240101-000000-0000", 404, "capture"),
        ("GET", "/v1/jobs/..%2f..%2fetc", 404, ""),
        ("GET", "/v1/jobs/j20240101-000000-0000/artefacts", 404, "job"),
        ("POST", "/v1/jobs/j20240101-000000-0000/cancel", 404, "job"),
        ("GET", "/nothing", 404, "Not Found"),
        ("DELETE", "/v1/jobs", 405, ""),
    ],
)
def test_what_is_not_there_is_a_problem(http: TestClient, method: str, path: str, status: int, word: str) -> None:
    assert_problem(http.request(method, path), status, word)


@pytest.mark.parametrize(
    ("path", "body", "words"),
    [
        ("/v1/rigs/lab3x3/captures", {"ticks": 0}, ["body.ticks", "found 0"]),
        ("/v1/rigs/lab3x3/captures", {"ticks": 5, "out": "/etc"}, ["body.out"]),
        ("/v1/rigs/lab3x3/captures", {"ticks": 5, "name": "a\nb"}, ["body.name"]),
        ("/v1/rigs/lab3x3/captures", "{", ["body"]),
        ("/v1/jobs", {"capture": "c", "model": "crystal"}, ["body.reconstruct.model", "crystal", "linear"]),
        ("/v1/jobs", {"capture": "c", "budget_s": 1, "steps": 1}, ["at most one"]),
        ("/v1/jobs", {"capture": "../../etc"}, ["../../etc"]),
    ],
)
def test_a_bad_request_says_what_was_found(http: TestClient, path: str, body: object, words: list[str]) -> None:
    content = body if isinstance(body, str) else json.dumps(body)
    response = http.post(path, content=content, headers={"Content-Type": "application/json"})
    assert_problem(response, 422, *words)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "localhost:8000"}, 200),
        ({"Host": "[::1]:8000"}, 200),
        ({"Origin": LOOPBACK}, 200),
        ({"Host": "evil.example"}, 403),
        ({"Host": "127.0.0.1.evil.example"}, 403),
        ({"Host": ""}, 403),
        ({"Host": "[::1"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "http://127.0.0.1:9999"}, 403),
        ({"Origin": "null"}, 403),
    ],
)
def test_only_its_own_pages_and_names_reach_it(http: TestClient, headers: dict[str, str], status: int) -> None:
    response = http.get("/v1/info", headers=headers)
    assert response.status_code == status
    if status != 200:
        assert_problem(response, status)


def test_the_page_needs_nothing_from_elsewhere(http: TestClient) -> None:
    for path in ("/", "/page.css", "/page.js"):
        response = http.get(path)
        assert response.status_code == 200
        assert "//" not in response.text.replace("// ", "")
        assert response.headers["content-security-policy"].startswith("default-src 'self'")


def test_ready_tells_a_missing_worker(tmp_path: Path) -> None:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url=LOOPBACK) as http:
        assert_problem(http.get("/v1/readyz"), 503, "no worker")
        assert http.get("/v1/healthz").json() == {"ok": True}
        late = Workers(http.app.state.services.store.database, clock=lambda: time.time() - 60)  # type: ignore[attr-defined]
        late.enter("slow", ["tasks"])
        assert_problem(http.get("/v1/readyz"), 503, "no worker")
        assert http.get("/v1/workers").json() == {"items": []}


def test_a_rig_records_one_capture_at_a_time(tmp_path: Path) -> None:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url=LOOPBACK) as http:
        first = http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5})
        assert first.status_code == 202
        assert http.get(first.headers["Location"]).json() == first.json()
        assert http.get("/v1/rigs/lab3x3").json()["busy"] == first.json()["id"]
        assert_problem(http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5}), 409, first.json()["id"])
        assert_problem(http.post("/v1/jobs", json={"capture": first.json()["id"]}), 409, "queued")


def test_a_full_disk_is_said(tmp_path: Path) -> None:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url=LOOPBACK) as http:
        with http.app.state.services.store.database.connect() as connection:  # type: ignore[attr-defined]
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar()

        def full(connection: Any, record: object, proxy: object) -> None:
            connection.execute(f"PRAGMA max_page_count={pages}")

        event.listen(http.app.state.services.store.database, "checkout", full)  # type: ignore[attr-defined]
        wordy = {"ticks": 5, "name": "n" * 80}
        keys = [{"Idempotency-Key": f"{n:0200}"} for n in range(40)]
        answers = [http.post("/v1/rigs/lab3x3/captures", json=wordy, headers=key) for key in keys]
        refused = next(answer for answer in answers if answer.status_code not in (202, 409))
        assert_problem(refused, 507, "No space left")
        assert http.get("/v1/captures").status_code == 200


# With a worker


def test_a_capture_becomes_a_reconstruction(client: ServiceClient, http: TestClient, capture: Capture) -> None:
    assert (capture.name, capture.fraction, capture.error) == ("forty", 1.0, None)
    job = client.submit(ReconstructRequest(capture=capture.id, holdout="cam11", steps=5))
    wait_for(lambda: client.job(job.id).status == "done")
    job = client.job(job.id)
    assert list(job.seconds) == ["plan", "poses", "images", "points", "train", "report"]
    assert {artefact.name for artefact in client.artefacts(job.id)} == {
        *("run.json", "metrics.json", "report.html", "thumbnails/render_000120.png")
    }
    assert json.loads(client.artefact(job.id, "metrics.json"))["psnr_db"] == 32.5
    assert "--stage train --model auto" in client.log(job.id)
    part = http.get(f"/v1/jobs/{job.id}/artefacts/report.html", headers={"Range": "bytes=1-5"})
    assert (part.status_code, part.text) == (206, "title")
    assert_problem(http.post(f"/v1/jobs/{job.id}/cancel"), 409, "found", "done")
    assert_problem(http.post(f"/v1/jobs/{job.id}/resume"), 409, "done")


def test_artefacts_are_named_and_never_links(client: ServiceClient, data: Path, capture: Capture) -> None:
    job = client.submit(ReconstructRequest(capture=capture.id))
    wait_for(lambda: client.job(job.id).status == "done")
    run = data / "jobs" / job.id / "run"
    for name in ("checkpoint.json", "..%2f..%2f..%2fworker.json", "orbit.mp4", "nothing"):
        with pytest.raises(RefusedError) as caught:
            client.artefact(job.id, name)
        assert caught.value.status == 404
    (run / "orbit.mp4").symlink_to("/etc/passwd")
    with pytest.raises(RefusedError, match=r"no artefact orbit\.mp4"):
        client.artefact(job.id, "orbit.mp4")
    assert "orbit.mp4" not in {artefact.name for artefact in client.artefacts(job.id)}


def test_a_failed_capture_says_why(client: ServiceClient, capture: Capture) -> None:
    failed = client.start_capture("lab3x3", CaptureRequest(ticks=13))
    wait_for(lambda: client.capture(failed.id).status == "failed")
    assert client.capture(failed.id).error == "cam11: found no answer, expected a camera; plug it in"
    assert client.rig("lab3x3").busy is None
    with pytest.raises(RefusedError, match="failed, expected it done"):
        client.submit(ReconstructRequest(capture=failed.id))


def test_a_holdout_must_be_a_camera_of_the_rig(client: ServiceClient, capture: Capture) -> None:
    with pytest.raises(RefusedError, match=r"camera cam77.*expected one of cam00") as caught:
        client.submit(ReconstructRequest(capture=capture.id, holdout="cam77"))
    assert caught.value.status == 422


def test_a_failed_job_goes_on_where_it_stopped(client: ServiceClient, data: Path, capture: Capture) -> None:
    fault = data / "jobs" / "fail-points"
    fault.touch()
    job = client.submit(ReconstructRequest(capture=capture.id))
    wait_for(lambda: client.job(job.id).status == "failed")
    found = client.job(job.id)
    assert (found.stage, found.error) == ("points", "points: found a fault, expected none; mend it")
    fault.unlink()
    assert client.resume(job.id).status in ("queued", "running")
    wait_for(lambda: client.job(job.id).status == "done")
    assert client.job(job.id).error is None
    stages = [line.split()[2] for line in client.log(job.id).splitlines() if line.startswith("arguments")]
    assert stages == ["plan", "poses", "images", "points", "points", "train", "report"]


def test_a_cancelled_job_stops_and_resumes_from_its_checkpoint(
    client: ServiceClient, data: Path, capture: Capture
) -> None:
    job = client.submit(ReconstructRequest(capture=capture.id))
    wait_for(lambda: (data / "jobs" / job.id / "run" / "checkpoint.json").exists())
    assert client.cancel(job.id).status == "cancelled"
    wait_for(lambda: not is_locked(data / "entries" / job.id))
    run = data / "jobs" / job.id / "run"
    pid, start = map(int, (run / "attempts.txt").read_text().split())
    assert start == 0
    assert not psutil.pid_exists(pid)
    done = json.loads((run / "checkpoint.json").read_text())["done"]
    assert client.job(job.id).status == "cancelled"
    client.resume(job.id)
    wait_for(lambda: client.job(job.id).status == "done")
    attempts = [int(line.split()[1]) for line in (run / "attempts.txt").read_text().splitlines()]
    assert attempts == [0, done]


def test_a_second_worker_is_refused(client: ServiceClient, data: Path) -> None:
    second = subprocess.run(
        [sys.executable, "-m", "server.cli", "worker", "--data", data], capture_output=True, text=True, check=False
    )
    assert second.returncode == 2
    assert second.stderr.strip() == (
        f"spike4dgs: found another worker worker-0 on {data}, expected none; stop it or choose another --name"
    )


def spike4dgs(*arguments: object, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "server.cli", *map(str, arguments)],
        env=os.environ | {"SPIKE4DGS_STAGE_COMMAND": json.dumps(FAKE)} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("command", ["serve", "worker"])
def test_a_data_folder_that_cannot_be_used_is_one_line(tmp_path: Path, command: str) -> None:
    (tmp_path / "dbos.sqlite").write_bytes(b"no database" * 100)
    process = spike4dgs(command, "--data", tmp_path)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert err.count("\n") == 1
    assert f"{tmp_path}: found dbos.sqlite damaged (file is not a database)" in err


def test_a_port_in_use_is_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        process = spike4dgs("serve", "--port", port, "--data", tmp_path)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "")
    assert (
        err == f"spike4dgs: found port {port} on 127.0.0.1: address already in use; stop what uses it or pass --port\n"
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_service_stops_quietly_with_its_worker(tmp_path: Path, number: signal.Signals) -> None:
    service = spike4dgs("serve", "--port", 0, "--data", tmp_path / "data", "--with-worker")
    assert service.stdout is not None
    with ServiceClient.at(service.stdout.readline().strip()) as client:
        wait_for(lambda: client.checks()["worker"].ok)
    family = psutil.Process(service.pid).children(recursive=True)
    assert len(family) == 1
    service.send_signal(number)
    _, err = service.communicate(timeout=60)
    assert (service.returncode, err) == (0 if number == signal.SIGINT else 143, "")
    assert psutil.wait_procs(family, timeout=0)[1] == []
    assert not is_locked(tmp_path / "data")


@pytest.mark.slow
def test_the_demo_prints_its_table(tmp_path: Path) -> None:
    demo = spike4dgs("demo", "--out", tmp_path / "demo", "--ticks", 40)
    out, err = demo.communicate(timeout=120)
    assert demo.returncode == 0, err
    rows = {line.split("  ")[0]: line.split() for line in out.splitlines()}
    assert rows["reconstruction"][1:] == ["32.50", "0.950", "0.0120", "0.990"]
    assert rows["nearest view"][2:] == ["17.00", "0.400", "0.1000", "0.900"]
    report = next(line.removeprefix("report: ") for line in out.splitlines() if line.startswith("report: "))
    assert Path(report).is_file()
    again = spike4dgs("demo", "--out", tmp_path / "demo")
    assert "expected a new folder" in again.communicate(timeout=60)[1]
    assert again.returncode == 2


@pytest.mark.slow
@pytest.mark.parametrize("during", ["record", "train"])
def test_an_interrupted_demo_leaves_nothing_behind(tmp_path: Path, during: str) -> None:
    ticks = 100_000 if during == "record" else 40
    demo = spike4dgs("demo", "--out", tmp_path / "demo", "--ticks", ticks, FAKE_STEPS="100000")
    wait_for(lambda: any((tmp_path / "demo").rglob("attempts.txt" if during == "train" else ".*.aside")))
    family = psutil.Process(demo.pid).children(recursive=True)
    assert len(family) == 3  # service, worker, stage
    demo.send_signal(signal.SIGINT)
    out, err = demo.communicate(timeout=60)
    assert demo.returncode == 130
    assert "Traceback" not in out + err
    assert psutil.wait_procs(family, timeout=0)[1] == []
    folders = [path for path in (tmp_path / "demo").rglob("*") if path.is_dir()]
    assert [folder for folder in [tmp_path / "demo", *folders] if is_locked(folder)] == []
