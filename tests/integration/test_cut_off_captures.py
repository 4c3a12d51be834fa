"""Tests that a capture is recorded once: what cuts it off is said, and no recording of another moment replaces it."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for

from rigs.toml import catalog_rig, dump_rig
from server.app import create_app
from server.client import RefusedError, ServiceClient
from server.schemas.captures import Capture, CaptureRequest, ManifestInfo
from server.settings import RigSource, ServiceSettings

pytestmark = pytest.mark.slow
RIG = catalog_rig("ci3x3")
TICKS = 20_000  # far more than are recorded before a test cuts the capture off


@pytest.fixture
def rigs(tmp_path: Path) -> dict[str, RigSource]:
    (tmp_path / "small.toml").write_text(dump_rig(RIG))
    devices = "mock:fan_and_ball?samples=1&truth_every=1000000"
    return {"small": RigSource(rig=str(tmp_path / "small.toml"), devices=devices)}


@pytest.fixture
def client(tmp_path: Path, rigs: dict[str, RigSource]) -> Iterator[ServiceClient]:
    settings = ServiceSettings(data=tmp_path / "data", rigs=rigs)
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as http:
        yield ServiceClient(http)


@pytest.fixture
def start_worker(tmp_path: Path, rigs: dict[str, RigSource]) -> Iterator[Callable[[], psutil.Process]]:
    workers: list[subprocess.Popen[bytes]] = []
    environment = os.environ | {"SPIKE4DGS_RIGS": json.dumps({name: rig.model_dump() for name, rig in rigs.items()})}

    def start() -> psutil.Process:
        command = [sys.executable, "-m", "server.cli", "worker", "--data", str(tmp_path / "data")]
        workers.append(subprocess.Popen(command, env=environment))
        return psutil.Process(workers[-1].pid)

    yield start
    for one in workers:
        one.terminate()
        one.wait(30)


def recorder_of(worker: psutil.Process) -> psutil.Process:
    (recorder,) = worker.children()
    return recorder


def journalled(tmp_path: Path, capture: Capture) -> bool:
    partial = tmp_path / "data/captures" / f"{capture.id}.partial"
    return len(list(partial.glob("*.journal"))) == 9 and all(f.stat().st_size for f in partial.glob("*.journal"))


def recording(client: ServiceClient, tmp_path: Path, **request) -> Capture:
    """Start a capture and return once blocks of every camera are on the disk."""
    capture = client.start_capture("small", CaptureRequest(**request))
    wait_for(lambda: journalled(tmp_path, capture))
    return capture


def ended(client: ServiceClient, capture: Capture) -> Capture:
    wait_for(lambda: client.capture(capture.id).status not in ("queued", "running"))
    return client.capture(capture.id)


def kept(client: ServiceClient, capture: Capture) -> ManifestInfo:
    end = ended(client, capture)
    assert (end.status, end.error) == ("done", None)
    manifest = client.manifest(capture.id)
    assert manifest.status == "incomplete"
    assert manifest.reason is not None
    assert end.message == f"kept, incomplete: {manifest.reason}"
    assert all(0 < camera.planes < TICKS for camera in manifest.cameras)
    return manifest


def test_a_killed_recorder_leaves_what_it_had_and_records_no_other_moment(client, start_worker, tmp_path) -> None:
    worker = start_worker()
    capture = recording(client, tmp_path, ticks=TICKS)
    recorder = recorder_of(worker)
    recorder.suspend()  # else it would end in order
    worker.kill()
    recorder.kill()
    worker.wait(20)
    partial = tmp_path / "data/captures" / f"{capture.id}.partial"
    most = (partial / "cam00.dat").stat().st_size
    start_worker()
    manifest = kept(client, capture)
    assert "killed" in manifest.reason
    assert 0 < next(c.bytes for c in manifest.cameras if c.id == "cam00") <= most
    assert not partial.exists()


def test_a_recorder_killed_beside_its_worker_leaves_what_it_had(client, start_worker, tmp_path) -> None:
    worker = start_worker()
    capture = recording(client, tmp_path, ticks=TICKS)
    recorder_of(worker).kill()
    assert "killed" in kept(client, capture).reason


@pytest.fixture
def failed(client, start_worker, tmp_path) -> Capture:
    """A capture whose recorder was killed and whose planes nobody has finalised yet."""
    worker = start_worker()
    capture = recording(client, tmp_path, ticks=TICKS)
    partial = tmp_path / "data/captures" / f"{capture.id}.partial"
    recorder = recorder_of(worker)
    recorder.suspend()
    manifest = (partial / "recording.json").rename(partial / "kept.json")  # it cannot be finalised without
    recorder.kill()
    assert ended(client, capture).status == "failed"
    manifest.rename(partial / "recording.json")
    return client.capture(capture.id)


def test_what_a_failed_capture_left_is_told_and_finalised_on_demand(client, failed) -> None:
    assert 0 < failed.partial_planes < TICKS
    (listed,) = client.captures(status="failed")
    assert listed == failed
    assert client.finalise_capture(failed.id).status in ("queued", "running")
    assert max(camera.planes for camera in kept(client, failed).cameras) == failed.partial_planes
    with pytest.raises(RefusedError, match="found no planes"):
        client.finalise_capture(failed.id)


def test_a_deleted_capture_leaves_nothing(client, failed, tmp_path) -> None:
    client.delete_capture(failed.id)
    assert list((tmp_path / "data/captures").iterdir()) == []
    assert not (tmp_path / "data/entries" / failed.id).exists()


def test_a_recorder_ends_in_order_when_its_worker_is_killed(client, start_worker, tmp_path) -> None:
    worker = start_worker()
    capture = recording(client, tmp_path, ticks=TICKS)
    worker.kill()
    worker.wait(20)
    wait_for(lambda: (tmp_path / "data/captures" / capture.id / "recording.json").exists())
    start_worker()
    assert "cut off" in kept(client, capture).reason


def test_a_worker_that_is_told_to_end_cuts_a_capture_off(client, start_worker, tmp_path) -> None:
    worker = start_worker()
    capture = recording(client, tmp_path, until_stopped=True)
    worker.terminate()
    worker.wait(30)
    start_worker()
    assert "cut off" in kept(client, capture).reason


def test_stop_without_a_worker_ends_the_capture(client, start_worker, tmp_path) -> None:
    worker = start_worker()
    capture = recording(client, tmp_path, until_stopped=True)
    recorder = recorder_of(worker)
    recorder.suspend()
    worker.kill()
    recorder.kill()
    worker.wait(20)
    assert client.stop_capture(capture).status == "running"
    start_worker()
    assert "killed" in kept(client, capture).reason


def test_a_capture_that_kept_nothing_is_missed(client, start_worker, tmp_path) -> None:
    capture = client.start_capture("small", CaptureRequest(ticks=40))
    folder = tmp_path / "data/entries" / capture.id
    folder.mkdir()
    (folder / "begun").touch()  # as if its worker had died as it began
    start_worker()
    end = ended(client, capture)
    assert end.status == "failed"
    assert "the moment has passed" in end.error
    assert not (tmp_path / "data/captures" / capture.id).exists()
