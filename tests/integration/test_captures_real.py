"""Captures through the service with nothing played: real stages on simulated cameras, real sockets, kill -9."""

import hashlib
import io
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for
from PIL import Image

from acquisition.recording.reader import Recording
from rigs.exchange.nerfstudio import dump_transforms
from rigs.toml import catalog_rig, dump_rig
from server.app import create_app
from server.client import RefusedError, ServiceClient
from server.schemas.captures import Capture, CaptureRequest, ImportRequest
from server.schemas.job_types import LookRequest, PreflightRequest, ReconstructRequest, VerifyRequest
from server.schemas.uploads import UploadRequest
from server.settings import RigSource, ServiceSettings

pytestmark = pytest.mark.slow
RIG, WIDE = catalog_rig("lab3x3").scaled(40, 25), catalog_rig("lab3x3").scaled(100, 64)
DEVICES = "mock:fan_and_ball?samples=1&truth_every=1000000"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("real") / "data"


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[ServiceClient]:
    data.mkdir()
    (data / "small.toml").write_text(dump_rig(RIG))
    (data / "wide.toml").write_text(dump_rig(WIDE))
    rigs = {name: RigSource(rig=str(data / f"{name}.toml"), devices=DEVICES) for name in ("small", "wide")}
    environment = os.environ | {"SPIKE4DGS_RIGS": json.dumps({name: rig.model_dump() for name, rig in rigs.items()})}
    command = [sys.executable, "-m", "server.cli", "worker", "--data", str(data)]
    worker = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    with TestClient(create_app(ServiceSettings(data=data, rigs=rigs)), base_url="http://127.0.0.1") as http:
        service = ServiceClient(http)
        wait_for(lambda: service.checks()["worker"].ok)
        yield service
        worker.terminate()
        assert "Traceback" not in worker.communicate(timeout=30)[1]


def ended(client: ServiceClient, capture: Capture) -> Capture:
    wait_for(lambda: client.capture(capture.id).status not in ("queued", "running"))
    return client.capture(capture.id)


def finished(client: ServiceClient, job_id: str) -> None:
    wait_for(lambda: client.job(job_id).status not in ("queued", "running"))
    job = client.job(job_id)
    assert (job.status, job.error) == ("done", None)


def recording_with(client: ServiceClient, capture: Capture, word: str) -> None:
    wait_for(lambda: word in client.capture(capture.id).message or client.capture(capture.id).error is not None)
    assert client.capture(capture.id).error is None


def test_a_capture_until_stopped_is_done_when_it_is_stopped(client: ServiceClient, data: Path) -> None:
    capture = client.start_capture("small", CaptureRequest(until_stopped=True))
    recording_with(client, capture, "9 of 9 cameras good")
    busy = client.rig_status("small").busy
    assert busy is not None
    assert (busy.id, busy.type, busy.status) == (capture.id, "record", "running")
    for refused in (client.look, client.preflight):
        with pytest.raises(RefusedError, match=capture.id) as caught:
            refused("small")
        assert caught.value.status == 409
    client.stop_capture(capture)
    assert ended(client, capture).status == "done"
    manifest = client.manifest(capture.id)
    assert (manifest.status, manifest.reason) == ("complete", None)
    (planes,) = {camera.planes for camera in manifest.cameras}
    assert planes > 0
    assert Recording.open(data / "captures" / capture.id).planes == planes


def test_a_scene_is_shown_while_its_capture_is_recorded(client: ServiceClient) -> None:
    capture = client.start_capture("wide", CaptureRequest(until_stopped=True))
    job = client.submit(ReconstructRequest(capture=capture.id, follow=True, holdout="cam11", steps=8))
    shown = lambda: {one.name for one in client.artefacts(job.id)}  # noqa: E731
    wait_for(lambda: "viewer.json" in shown() or client.job(job.id).status not in ("queued", "running"))
    now = client.job(job.id)
    assert (now.status, now.stage, client.capture(capture.id).status) == ("running", "follow", "running")
    assert now.preview is not None
    assert now.preview.camera == "cam11"
    client.stop_capture(capture)
    assert ended(client, capture).status == "done"
    wait_for(lambda: client.job(job.id).stage != "follow")  # the run begins; how long it takes hangs on the machine
    assert client.job(job.id).error is None
    client.cancel(job.id)
    wait_for(lambda: client.job(job.id).status == "cancelled")
    assert {"viewer.json", "viewer.bin"} <= shown()


def test_a_save_keeps_the_planes_before_it(client: ServiceClient) -> None:
    capture = client.start_capture("small", CaptureRequest(until_stopped=True, pre_trigger_ms=2))
    recording_with(client, capture, "waiting to be told to save")
    wait_for(lambda: not client.capture(capture.id).message.endswith(" 0 planes seen"))
    client.save_capture(capture)
    wait_for(lambda: "waiting" not in client.capture(capture.id).message)
    client.stop_capture(capture)
    assert ended(client, capture).status == "done"
    manifest = client.manifest(capture.id)
    assert manifest.trigger_plane is not None
    assert 0 < manifest.trigger_plane <= 40
    assert min(camera.planes for camera in manifest.cameras) > manifest.trigger_plane


def test_a_capture_stopped_before_it_was_saved_is_cancelled_and_keeps_nothing(
    client: ServiceClient, data: Path
) -> None:
    capture = client.start_capture("small", CaptureRequest(until_stopped=True, pre_trigger_ms=2))
    recording_with(client, capture, "waiting to be told to save")
    client.stop_capture(capture)
    end = ended(client, capture)
    assert (end.status, end.error) == ("cancelled", None)
    assert end.message == "stopped before it was told to save, so nothing was kept"
    assert not (data / "captures" / capture.id).exists()


def test_a_capture_stopped_as_soon_as_it_was_asked_for_never_failed(client: ServiceClient, data: Path) -> None:
    capture = client.start_capture("small", CaptureRequest(until_stopped=True))
    client.stop_capture(capture)
    end = ended(client, capture)
    assert end.error is None
    if end.status == "cancelled":
        assert end.message.endswith("so nothing was kept")
        assert not (data / "captures" / capture.id).exists()
    else:
        assert end.status == "done"  # a worker was faster, and kept planes


def test_a_preflight_tells_how_every_camera_is(client: ServiceClient) -> None:
    job = client.preflight("small", PreflightRequest(disk_seconds=0.1))
    finished(client, job.id)
    assert [artefact.name for artefact in client.artefacts(job.id)] == ["result.json"]
    status = client.rig_status("small")
    assert (status.worker, status.busy) == (True, None)
    assert status.preflight is not None
    assert status.preflight.job == job.id
    assert {"camera cam00", "firmware", "clock latch", "room"} <= {check.name for check in status.preflight.checks}
    assert [camera.id for camera in status.cameras] == list(RIG.ids)
    for camera, expected in zip(status.cameras, RIG.cameras, strict=True):
        assert (camera.connected, camera.serial, camera.link_errors) == (True, expected.serial, 0)
        assert camera.skew_us is not None
        assert abs(camera.skew_us) < 50
        assert camera.firmware is not None


def test_a_look_leaves_a_picture_and_nothing_else(client: ServiceClient, data: Path) -> None:
    first = client.look("small", LookRequest(ticks=30))
    finished(client, first.id)
    sheet = np.asarray(Image.open(io.BytesIO(client.look_picture("small"))))
    assert sheet.shape == (3 * 29 - 4, 3 * 44 - 4)
    assert sheet.std() > 20
    assert [artefact.name for artefact in client.artefacts(first.id)] == ["look.png"]
    assert sorted(path.name for path in (data / "jobs" / first.id).iterdir()) == ["out"]
    seen = client.look_figures("small")
    assert {one.planes for one in seen.cameras} == {30}
    assert all(one.focus and one.focus > 0 and sum(one.histogram) == pytest.approx(1) for one in seen.cameras)
    alone = np.asarray(Image.open(io.BytesIO(client.look_picture("small", "cam11"))))
    assert alone.shape == (seen.cameras[4].height, seen.cameras[4].width)
    before = client.rig_status("small").look
    second = client.look("small", LookRequest(ticks=60))
    finished(client, second.id)
    after = client.rig_status("small").look
    assert before is not None
    assert after is not None
    assert before.etag != after.etag
    assert client.look_figures("small").etag != seen.etag
    assert [job.id for job in client.jobs(type="look")] == [second.id]
    assert not list((data / "captures").glob("*look*"))


@pytest.mark.parametrize("cameras", ["transforms", "rig file", "rig"])
def test_nine_uploads_become_a_capture_bit_for_bit(
    client: ServiceClient, data: Path, tmp_path: Path, cameras: str
) -> None:
    rng = np.random.default_rng(1)
    dats = {camera_id: rng.bytes(125 * 40) for camera_id in RIG.ids}
    for camera_id, planes in dats.items():
        (tmp_path / camera_id).write_bytes(planes)
    (tmp_path / "cameras").write_text(dump_transforms(RIG.cameras) if cameras == "transforms" else dump_rig(RIG))
    uploads = {camera_id: client.send_file(tmp_path / camera_id).id for camera_id in RIG.ids}
    chosen = {"rig": "small"} if cameras == "rig" else client.send_file(tmp_path / "cameras").id
    ordered = list(uploads.values()) if cameras == "rig file" else uploads
    request = ImportRequest.model_validate(
        {"uploads": ordered, "cameras": chosen, "tick_rate_hz": 20000, "poses": "nominal"}
    )
    capture = ended(client, client.import_capture(request))
    assert (capture.status, capture.error, capture.type) == ("done", None, "import")
    for camera_id, planes in dats.items():
        assert (data / "captures" / capture.id / f"{camera_id}.dat").read_bytes() == planes
    assert Recording.open(data / "captures" / capture.id).rig.poses == "nominal"
    assert len(client.preview(capture.id)) > len(client.preview(capture.id, "cam11")) > 0
    job = client.submit(VerifyRequest(type="verify", capture=capture.id))
    finished(client, job.id)
    verified = client.manifest(capture.id).verified
    assert verified is not None
    assert (verified.job, verified.sound, verified.damages) == (job.id, True, [])
    for upload_id in uploads.values():
        client.delete_upload(upload_id)
    client.delete_capture(capture.id)


def test_an_import_of_cut_planes_says_what_is_wrong(client: ServiceClient, tmp_path: Path) -> None:
    uploads = []
    for camera_id in RIG.ids:
        (tmp_path / camera_id).write_bytes(bytes(125 * 3 + (camera_id == "cam02")))
        uploads.append(client.send_file(tmp_path / camera_id).id)
    request = ImportRequest.model_validate({"uploads": uploads, "cameras": {"rig": "small"}, "tick_rate_hz": 20000})
    capture = ended(client, client.import_capture(request))
    assert capture.status == "failed"
    assert "cam02" in (capture.error or "")
    assert "1 more than 3 whole planes" in (capture.error or "")
    again = ended(client, client.import_capture(request.model_copy(update={"allow_partial": True})))
    assert again.status == "done"
    assert {camera.id: camera.partial_bytes for camera in client.manifest(again.id).cameras}["cam02"] == 1


# Over a real socket


def serve(data: Path) -> tuple[subprocess.Popen[str], str]:
    command = [sys.executable, "-m", "server.cli", "serve", "--port", "0", "--data", str(data)]
    environment = os.environ | {"SPIKE4DGS_KEEP_FREE_BYTES": "0"}
    service = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    assert service.stdout is not None
    return service, service.stdout.readline().strip()


def half_sent(address: str, upload_id: str, data: bytes, said: int) -> socket.socket:
    """A connection that says it will send `said` bytes and has sent only `data`."""
    where = urlsplit(address)
    connection = socket.create_connection((where.hostname or "", where.port or 0))
    head = f"PATCH /v1/uploads/{upload_id} HTTP/1.1\r\nHost: {where.netloc}\r\nUpload-Offset: 0\r\n"
    connection.sendall(f"{head}Content-Length: {said}\r\n\r\n".encode() + data)
    return connection


def test_kill_9_in_an_upload_loses_at_most_the_last_piece(tmp_path: Path) -> None:
    data = np.random.default_rng(2).bytes(6_000_000)
    service, address = serve(tmp_path / "data")
    with ServiceClient.at(address) as client:
        asked = UploadRequest(name="big", bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
        upload_id = client.begin_upload(asked).id
        with half_sent(address, upload_id, data[:4_000_000], len(data)):
            wait_for(lambda: client.upload(upload_id).offset >= 2_900_000)
            with pytest.raises(RefusedError, match="one at a time") as caught:
                client.append(upload_id, b"x", client.upload(upload_id).offset)
            assert caught.value.status == 409
            service.send_signal(signal.SIGKILL)
            service.communicate()
    service, address = serve(tmp_path / "data")
    with ServiceClient.at(address) as client:
        kept = client.upload(upload_id).offset
        assert 2_900_000 <= kept <= 4_000_000
        (tmp_path / "big").write_bytes(data)
        assert client.send_file(tmp_path / "big", upload_id).sha256 == hashlib.sha256(data).hexdigest()
    service.terminate()
    service.communicate()


def test_a_connection_that_breaks_off_keeps_all_that_came(tmp_path: Path) -> None:
    data = np.random.default_rng(3).bytes(500_000)
    service, address = serve(tmp_path / "data")
    with ServiceClient.at(address) as client:
        upload_id = client.begin_upload(UploadRequest(name="cut", bytes=len(data))).id
        half_sent(address, upload_id, data[:300_000], len(data)).close()
        wait_for(lambda: client.upload(upload_id).offset == 300_000)
        (tmp_path / "cut").write_bytes(data)
        wait_for(lambda: _goes_on(client, tmp_path / "cut", upload_id))
        assert client.upload(upload_id).sha256 == hashlib.sha256(data).hexdigest()
    service.terminate()
    assert "Traceback" not in service.communicate()[1]


def _goes_on(client: ServiceClient, path: Path, upload_id: str) -> bool:
    try:
        return client.send_file(path, upload_id).state == "committed"
    except RefusedError as error:
        if error.status != 409:  # else the broken one is not over yet
            raise
        return False


def test_a_full_disk_is_told_and_the_upload_goes_on_when_there_is_room(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", disk], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("may not mount a small disk: needs root")
    try:
        service, address = serve(disk / "data")
        with ServiceClient.at(address) as client:
            data = np.random.default_rng(4).bytes(6_000_000)
            upload_id = client.begin_upload(UploadRequest(name="a", bytes=len(data))).id
            free = os.statvfs(disk)
            (disk / "filler").write_bytes(bytes(free.f_bavail * free.f_frsize - 3_000_000))
            with pytest.raises(RefusedError) as caught:
                client.append(upload_id, data, 0)
            assert caught.value.status == 507
            assert 0 < client.upload(upload_id).offset <= 3_000_000
            (disk / "filler").unlink()
            (tmp_path / "a").write_bytes(data)
            assert client.send_file(tmp_path / "a", upload_id).sha256 == hashlib.sha256(data).hexdigest()
        service.terminate()
        service.communicate()
    finally:
        subprocess.run(["umount", "-l", disk], check=False)
