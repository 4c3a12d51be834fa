"""A disk that fills up under a job: the job says so in one line or waits, and goes on when there is room again."""

import contextlib
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from maintenance.deployment import Deployment
from maintenance.postgresql import PostgresqlMissingError
from maintenance.verdict import read_trace, torn
from maintenance.waiting import wait_for

from server.client import RefusedError, ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest
from server.schemas.jobs import Job
from server.schemas.uploads import UploadRequest

pytestmark = pytest.mark.slow
DATABASES = ["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=128m", "tmpfs", folder]  # its reserve holds SQLite's journal
    mounted = subprocess.run(command, capture_output=True, text=True, check=False)
    if mounted.returncode != 0:
        pytest.skip(f"needs to mount a small disk: {mounted.stderr.strip()}")
    yield folder
    subprocess.run(["umount", folder], check=True)


@pytest.fixture(params=DATABASES)
def deployment(request: pytest.FixtureRequest, disk: Path) -> Iterator[Deployment]:
    environment = {"SPIKE4DGS_KEEP_FREE_BYTES": "0"}
    try:
        made = Deployment(disk / "data", postgresql=request.param == "postgresql", dead_s=4.0, environment=environment)
    except PostgresqlMissingError as error:
        pytest.skip(str(error))
    yield made
    made.close()


def seen(client: ServiceClient, job_id: str) -> Job | None:
    """The job, where the service can say."""
    try:
        return client.job(job_id)
    except (httpx.TransportError, RefusedError):
        return None


def ready(client: ServiceClient) -> bool:
    try:
        return [one.id for one in client.workers()] == ["a"]
    except (httpx.TransportError, RefusedError):
        return False


def fill(disk: Path, left: int) -> Path:
    """A file that takes all room but `left` bytes."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as file:
        with contextlib.suppress(OSError):
            while file.write(bytes(1 << 16)):
                pass
        file.truncate(file.tell() - left)
    return filler


def in_training(client: ServiceClient, deployment: Deployment) -> tuple[str, str]:
    """Record a capture and let a job train on it; return their ids."""
    wait_for(lambda: ready(client))
    capture = client.start_capture("lab3x3", CaptureRequest(ticks=5)).id
    wait_for(lambda: client.capture(capture).status == "done")
    job = client.submit(ReconstructRequest(capture=capture)).id
    trace = deployment.data / "jobs" / job / "trace.txt"
    wait_for(lambda: trace.exists() and "begin train" in trace.read_text())
    return capture, job


@pytest.mark.parametrize("left", [0, 64 * 1024], ids=["progress", "artefact"])
def test_a_job_outlives_a_full_disk(deployment: Deployment, disk: Path, left: int) -> None:
    """No room at all stops the checkpoints and, on SQLite, the progress; some room only the artefacts of the report."""
    for name in ("api", "a"):
        deployment.start(name)
    with ServiceClient.at(deployment.address) as client:
        _, job = in_training(client, deployment)
        folder = deployment.data / "jobs" / job
        filler = fill(disk, left)
        time.sleep(5.0)  # longer than the rest of the job takes
        during = seen(client, job)
        assert during is None or during.status in ("running", "failed")
        assert not (folder / "run" / "report.html").exists()
        assert torn(folder, []) == []
        filler.unlink()
        wait_for(lambda: (now := seen(client, job)) is not None and settled(client, now))
        wait_for(lambda: client.job(job).status == "done")
        count = read_trace(folder)
        assert (count["completed"], count["repeated"], count["reopened"], count["missing"]) == (1, 0, 0, 0)
        assert torn(folder, client.artefacts(job)) == []
    assert deployment.dead() == []


def settled(client: ServiceClient, job: Job) -> bool:
    """Return whether the job is done, or was resumed after it said in one line what it lacks."""
    if job.status == "failed":
        assert job.error is not None
        assert "\n" not in job.error
        assert "space left" in job.error
        client.resume(job.id)
    return job.status in ("done", "failed")


def test_a_full_disk_is_emptied_from_the_service(deployment: Deployment, disk: Path) -> None:
    for name in ("api", "a"):
        deployment.start(name)
    with ServiceClient.at(deployment.address) as client:
        capture, job = in_training(client, deployment)
        waiting = client.submit(ReconstructRequest(capture=capture)).id
        upload = client.begin_upload(UploadRequest(name="a", bytes=1000)).id
        fill(disk, 0)
        with pytest.raises(RefusedError) as refused:
            client.begin_upload(UploadRequest(name="b", bytes=8 << 20))  # more than a job that ends lets go of
        assert refused.value.status == 507
        for one in (waiting, job):
            wait_for(lambda one=one: ended(client, one) in ("cancelled", "failed"))
        wait_for(lambda: done(client.delete_upload, upload))
        for one in (waiting, job):
            wait_for(lambda one=one: done(client.delete_job, one))
        wait_for(lambda: done(client.delete_capture, capture))
        assert client.captures() == client.jobs() == []
        assert list((deployment.data / "captures").iterdir()) == []


def ended(client: ServiceClient, job_id: str) -> str:
    """Cancel a job, and return the status that it ends in: the full disk may have ended it before."""
    with contextlib.suppress(RefusedError):
        return client.cancel(job_id).status
    return client.job(job_id).status


def done(act: Callable[[str], object], name: str) -> bool:
    """Return whether `act` was done: until its process has ended a job may be held, or hold the last room."""
    try:
        act(name)
    except RefusedError as error:
        if error.status not in (409, 507):
            raise
        return False
    return True
