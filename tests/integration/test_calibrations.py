"""Calibrations by a real worker whose stages are played by fake_stage.py, which lengthens every lens by a tenth."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for

from rigs.rig import Rig
from rigs.toml import catalog_rig, dump_rig, load_rig, parse_rig
from server.app import create_app
from server.client import RefusedError, ServiceClient
from server.schemas.calibrations import CalibrationChoice, CalibrationRequest
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.job_types import CalibrateRequest
from server.schemas.jobs import Job
from server.settings import RigSource, ServiceSettings
from server.store.tables import Found

FAKE = (sys.executable, str(Path(__file__).with_name("fake_stage.py")))
SOURCES = {name: RigSource(rig=name, devices="usb:") for name in ("lab3x3", "ci3x3")} | {
    "twin": RigSource(rig="lab3x3", devices="usb:")
}
LAB = catalog_rig("lab3x3")
PIXELS_OF_CAM00 = "cam00-pixels-2b4b2846a7b4ab96.npz"


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return tmp_path / "data"


@pytest.fixture
def client(data: Path) -> Iterator[ServiceClient]:
    with TestClient(create_app(ServiceSettings(data=data, rigs=SOURCES)), base_url="http://127.0.0.1") as http:
        yield ServiceClient(http)


@pytest.fixture
def start_worker(data: Path, client: ServiceClient) -> Iterator[Callable[[], subprocess.Popen[bytes]]]:
    workers: list[subprocess.Popen[bytes]] = []
    rigs = json.dumps({name: source.model_dump() for name, source in SOURCES.items()})
    environment = os.environ | {"SPIKE4DGS_STAGE_COMMAND": json.dumps(FAKE), "SPIKE4DGS_RIGS": rigs}

    def start() -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "server.cli", "worker", "--data", str(data)]
        workers.append(subprocess.Popen(command, env=environment))
        return workers[-1]

    yield start
    for worker in workers:
        worker.terminate()
        worker.wait(30)


def record(client: ServiceClient, rig_id: str = "lab3x3") -> Capture:
    made = client.start_capture(rig_id, CaptureRequest(ticks=40))
    wait_for(lambda: client.capture(made.id).status not in ("queued", "running"))
    return client.capture(made.id)


def ended(client: ServiceClient, job: Job) -> Job:
    wait_for(lambda: client.job(job.id).status not in ("queued", "running"))
    return client.job(job.id)


def recorded(data: Path, capture: Capture) -> Rig:
    return load_rig(data / "captures" / capture.id / "rig.toml")


@pytest.mark.slow
def test_captures_record_with_the_current_calibration(
    client: ServiceClient, data: Path, start_worker: Callable[[], object]
) -> None:
    start_worker()
    first = record(client)
    job = ended(client, client.calibrate("lab3x3", CalibrationRequest(capture=first.id)))
    assert (job.status, job.error) == ("done", None)
    now = client.current_calibration("lab3x3")
    assert (now.version, now.revision, now.source, now.job, now.poses) == (1, 1, "natural", job.id, "calibrated")
    assert (now.residual_px, now.rotation_sd_deg) == (0.1, 0.01)
    assert now.cameras["cam22"].focal_percent_sd == 0.1
    assert str(data) not in now.model_dump_json()
    assert client.calibration_picture("lab3x3", 1).startswith(b"\x89PNG")
    found = parse_rig(client.calibration_toml("lab3x3", 1), "toml", None)
    assert found.cameras[0].fx == pytest.approx(1.1 * LAB.cameras[0].fx)
    second = record(client)
    assert dump_rig(recorded(data, second)) == client.calibration_toml("lab3x3", 1)
    assert recorded(data, first).calibration is None

    kept = client.calibrate("lab3x3", CalibrationRequest(capture=second.id, apply=False))
    assert ended(client, kept).status == "done"
    assert [(one.version, one.job) for one in client.calibrations("lab3x3")] == [(2, kept.id), (1, job.id)]
    assert client.rig("lab3x3").calibration == 1
    client.delete_job(kept.id)
    assert client.calibration_picture("lab3x3", 2).startswith(b"\x89PNG")
    assert client.choose_calibration(now, CalibrationChoice(version=0)).version == 0
    with pytest.raises(RefusedError, match="has changed"):
        client.choose_calibration(now, CalibrationChoice(version=1))
    assert dump_rig(recorded(data, record(client))) == dump_rig(LAB)

    check = ended(client, client.check_calibration("lab3x3", second.id))
    assert {one.name for one in client.artefacts(check.id)} == {"calibration-0.toml", "result.json"}
    assert json.loads(client.artefact(check.id, "result.json")) == {"fits": False, "fx": LAB.cameras[0].fx}


@pytest.mark.slow
def test_pixel_maps_and_poses_are_kept_together(
    client: ServiceClient, data: Path, start_worker: Callable[[], object]
) -> None:
    start_worker()
    flat, dark = record(client), record(client)
    poses = client.calibrate("lab3x3", CalibrationRequest(capture=flat.id))
    pixels = client.calibrate("lab3x3", CalibrationRequest(flat=flat.id, dark=dark.id))
    assert [ended(client, job).status for job in (poses, pixels)] == ["done", "done"]
    assert "--pixels" in client.log(pixels.id)
    now = client.current_calibration("lab3x3")
    assert (now.version, now.source, now.cameras, now.residual_px) == (2, "pixels", {}, 0.1)
    rig = recorded(data, record(client))
    assert rig.cameras[0].fx == pytest.approx(1.1 * LAB.cameras[0].fx)
    assert [c.pixels and c.pixels.read_bytes() for c in rig.cameras] == [c.id.encode() for c in rig.cameras]
    again = client.calibrate("lab3x3", CalibrationRequest(capture=flat.id))  # which has no pixel maps
    assert ended(client, again).status == "done"
    assert client.calibration_toml("lab3x3", 3).count("-pixels-") == 9


@pytest.mark.slow
def test_a_recording_made_for_it_comes_first(
    client: ServiceClient, data: Path, start_worker: Callable[[], object]
) -> None:
    job = client.calibrate("lab3x3", CalibrationRequest(ticks=40, name="morning"))
    (capture,) = client.captures()
    assert (job.status, capture.name) == ("queued", "morning")
    start_worker()
    assert ended(client, job).status == "done"
    assert client.rig("lab3x3").calibration == 1
    failing = client.calibrate("lab3x3", CalibrationRequest(ticks=13))  # no camera answers
    assert ended(client, failing).status == "failed"
    assert "found no recording of c" in (client.job(failing.id).error or "")
    assert client.rig("lab3x3").calibration == 1


@pytest.mark.slow
def test_what_is_of_another_rig_or_not_found_changes_nothing(
    client: ServiceClient, data: Path, start_worker: Callable[[], object]
) -> None:
    start_worker()
    small, twin, fit = record(client, "ci3x3"), record(client, "twin"), record(client)
    for capture, words in ((small, "of rig ci3x3"), (twin, "of rig twin")):
        for body in ({"capture": capture.id}, {"flat": fit.id, "dark": capture.id}):
            with pytest.raises(RefusedError, match=words) as caught:
                client.calibrate("lab3x3", CalibrationRequest.model_validate(body))
            assert caught.value.status == 422
        with pytest.raises(RefusedError, match=words):
            client.check_calibration("lab3x3", capture.id)
        with pytest.raises(RefusedError, match=words):
            client.submit(CalibrateRequest(type="calibrate", capture=capture.id, rig="lab3x3", apply=True))
    with pytest.raises(RefusedError, match="found no rig lab9x9"):
        client.submit(CalibrateRequest(type="calibrate", capture=fit.id, rig="lab9x9"))
    rig_file = data / "captures" / fit.id / "rig.toml"
    rig_file.write_text(dump_rig(LAB.scaled(200, 125)))
    with pytest.raises(RefusedError, match="cam00: found a camera of 200x125 pixels, expected 400x250"):
        client.calibrate("lab3x3", CalibrationRequest(capture=fit.id))
    rig_file.write_text(dump_rig(LAB))

    fault = data / "jobs/fail-calibrate"
    fault.touch()
    job = ended(client, client.calibrate("lab3x3", CalibrationRequest(capture=fit.id)))
    assert (job.status, job.error) == ("failed", "found 3 tracks, expected 250; show more")
    assert client.calibrations("lab3x3") == []
    fault.unlink()
    client.resume(job.id)
    wait_for(lambda: client.job(job.id).status == "done")
    assert client.rig("lab3x3").calibration == 1


@pytest.mark.slow
def test_a_worker_mends_what_was_stored_and_never_written(
    client: ServiceClient, data: Path, start_worker: Callable[[], subprocess.Popen[bytes]]
) -> None:
    worker = start_worker()
    job = ended(client, client.calibrate("lab3x3", CalibrationRequest(ticks=40)))
    file = data / "rigs/lab3x3/calibration.toml"
    kept = file.read_text()
    worker.kill()
    worker.wait(20)
    file.write_text("half a fi")
    store = client._http.app.state.services.store  # type: ignore[attr-defined]
    again = store.calibrations.add("lab3x3", Found("natural", {}, job.id), lambda _: "another", apply=True)
    assert (again.version, again.document) == (1, kept)  # the killed worker's step is done again
    start_worker()
    wait_for(lambda: file.read_text() == kept)
    assert client.current_calibration("lab3x3").revision == 1
