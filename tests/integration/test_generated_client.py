"""A client that is generated from the OpenAPI document, with nothing of ours in it, does an operator's whole day."""

import importlib
import io
import json
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

FAKE = [sys.executable, str(Path(__file__).with_name("fake_stage.py"))]
TICKS = 60

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a service with a worker, whose stages stand in."""
    data = tmp_path_factory.mktemp("day")
    more = {"SPIKE4DGS_STAGE_COMMAND": json.dumps(FAKE), "FAKE_RESULTS": "1", "FAKE_STEPS": "40"}
    command = [sys.executable, "-m", "server.cli", "serve", "--port", "0", "--data", str(data), "--with-worker"]
    with subprocess.Popen(command, env=os.environ | more, stdout=subprocess.PIPE, text=True) as service:
        assert service.stdout is not None
        yield service.stdout.readline().strip()
        service.terminate()
        service.communicate(timeout=60)


@pytest.fixture(scope="module")
def generated(address: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Generate the client from the document that the service hands out, and let it be imported as `day_client`."""
    folder = tmp_path_factory.mktemp("generated")
    document = folder / "openapi.json"
    document.write_bytes(httpx.get(f"{address}/openapi.json", trust_env=False).content)
    tool = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none"]
    made = subprocess.run(
        [*tool, "--path", document, "--output-path", folder / "day_client"],
        capture_output=True,
        text=True,
        check=False,
    )
    if "No module named" in made.stderr:
        pytest.skip("openapi-python-client is not installed")
    assert made.returncode == 0, made.stdout + made.stderr
    sys.path.insert(0, str(folder))
    yield
    sys.path.remove(str(folder))


class Day:
    """Calls operations of the generated client by their names, and expects each to succeed."""

    def __init__(self, address: str) -> None:
        http = {"trust_env": False}
        self.client = importlib.import_module("day_client").Client(base_url=address, httpx_args=http)
        self.models = importlib.import_module("day_client.models")

    def __call__(self, operation: str, *parts: str, expect: int | None = None, **options: Any) -> Any:
        group, name = operation.split(".")
        module = importlib.import_module(f"day_client.api.{group}.{name}")
        answer = module.sync_detailed(*parts, client=self.client, **options)
        assert answer.status_code == expect if expect else answer.status_code < 300, answer.content
        return answer.content if answer.parsed is None else answer.parsed

    def until(self, condition: Callable[[], bool]) -> None:
        for _ in range(600):
            if condition():
                return
            time.sleep(0.1)
        raise AssertionError("waited for a minute in vain")

    def done(self, kind: str, entry_id: str) -> Any:
        look = f"{kind}s.get_{kind}"
        self.until(lambda: self(look, entry_id).status not in ("queued", "running"))
        found = self(look, entry_id)
        assert found.status == "done", found
        return found


@pytest.fixture
def day(address: str, generated: None) -> Iterator[Day]:
    day = Day(address)
    with day.client:
        day.until(lambda: bool(day("system.list_workers").items))
        yield day


def test_an_operators_day(day: Day) -> None:
    models = day.models
    assert day("system.get_info").name == "spike4dgs"
    (rig,) = day("rigs.list_rigs").items
    preflight = day("rigs.start_preflight", rig.id, body=models.PreflightRequest())
    day.done("job", preflight.id)
    assert day("rigs.get_rig_status", rig.id).preflight.job == preflight.id

    asked = models.CaptureRequest(ticks=TICKS, name="of the day")
    capture = day("rigs.start_capture", rig.id, body=asked, idempotency_key="morning")
    assert day("rigs.start_capture", rig.id, body=asked, idempotency_key="morning").id == capture.id
    day.done("capture", capture.id)
    assert len(day("captures.get_manifest", capture.id).cameras) == 9
    assert day("captures.get_preview", capture.id).startswith(b"\x89PNG")

    endless = day("rigs.start_capture", rig.id, body=models.CaptureRequest(until_stopped=True))
    day.until(lambda: bool(day("captures.get_capture", endless.id).message))
    day("rigs.stop_capture", rig.id, endless.id)
    day.done("capture", endless.id)

    job = day("jobs.submit_job", body=models.ReconstructRequest(capture=capture.id, holdout="cam11"))
    day.done("job", job.id)
    steps = day("jobs.list_steps", job.id).items
    assert [step.status for step in steps] == ["done"] * len(steps)
    names = {one.name for one in day("jobs.list_artefacts", job.id).items}
    assert "metrics.json" in names
    assert "psnr_db" in json.loads(day("jobs.get_artefact", job.id, "metrics.json"))
    with zipfile.ZipFile(io.BytesIO(day("jobs.get_archive", job.id))) as archive:
        assert {f"{job.id}/{name}" for name in names} == set(archive.namelist())

    batch = models.BatchRequest(jobs=[models.ReconstructRequest(capture=capture.id, seed=n) for n in range(5)])
    queued = day("jobs.submit_batch", body=batch).items
    assert [one.request.seed for one in queued] == list(range(5))
    day("jobs.prioritise_job", queued[4].id, body=models.PriorityRequest(priority=1), expect=None)
    for one in queued[1:4]:
        day("jobs.cancel_job", one.id)
    day.done("job", queued[0].id)
    day("jobs.resume_job", queued[1].id)
    for one in (queued[1], queued[4]):
        day.done("job", one.id)
    listed = day("jobs.list_jobs", limit=3)
    older = day("jobs.list_jobs", limit=3, cursor=listed.next_)
    assert listed.items[-1].id > older.items[0].id

    sent = day("uploads.begin_upload", body=models.UploadRequest(name="cam00.dat", bytes_=6))
    piece = importlib.import_module("day_client.types").File(io.BytesIO(b"spikes"))
    day("uploads.append_to_upload", sent.id, body=piece, upload_offset=0)
    assert day("uploads.commit_upload", sent.id).state == "committed"
    day("uploads.delete_upload", sent.id)

    for one in day("jobs.list_jobs").items:
        day("jobs.delete_job", one.id)
    for one in day("captures.list_captures").items:
        day("captures.delete_capture", one.id)
    assert day("captures.list_captures").items == day("jobs.list_jobs").items == []


def test_what_is_refused_is_a_problem_of_the_document(day: Day) -> None:
    problem = day("jobs.get_job", "j20260101-000000-00000000", expect=404)
    assert type(problem).__name__ == "Problem"
    assert "found no job" in problem.detail
