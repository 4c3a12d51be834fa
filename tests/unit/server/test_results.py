"""Jobs with more files than can be listed: refused where the request tells, else with a warning."""

import asyncio
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fastapi.testclient import TestClient
from maintenance.entries import added, imported

from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.decisions import Plan
from reconstruction.run.folder import RunFolder
from rigs.errors import Spike4dgsError
from rigs.toml import catalog_rig
from server.engine import TASKS, capture_queue
from server.services import results
from server.services.services import Services
from server.store import artefacts
from server.store.tables import Entry
from server.work import stages
from server.work.stages import Stages

RIG = catalog_rig("lab3x3").scaled(40, 24)
PLANES = 60
MOST = 80


@pytest.fixture(scope="module")
def capture(services: Services, tmp_path_factory: pytest.TempPathFactory) -> str:
    planes = np.zeros((PLANES, 24, 40), np.uint8)
    planes[::2, :, 7:] = 1
    return imported(services, RIG, [planes] * len(RIG.ids), tmp_path_factory.mktemp("dats"))


@pytest.fixture(scope="module")
def job(services: Services, capture: str) -> str:
    """A reconstruction that holds a camera out, and is planned."""
    job = added(services, "job", "reconstruct", capture=capture, request={"capture": capture})
    folder = services.store.folder
    config = ReconstructionConfig(holdout="cam11")
    run = RunFolder.start(folder.run(job), config, folder.recording(capture), "0123abc")
    views = tuple(camera_id for camera_id in RIG.ids if camera_id != "cam11")
    run.document.planned = Plan(views, "linear", "adaptive", "images", 10, 10, ())
    run.save()
    return job


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "MOST", MOST)


def asked(http: TestClient, **body: object) -> tuple[int, str]:
    answer = http.post("/v1/jobs", json=body)
    return answer.status_code, answer.json().get("detail", "")


def test_more_images_than_can_be_listed_are_refused(http: TestClient, capture: str) -> None:
    before = http.get("/v1/jobs").json()
    images = {"type": "images", "method": "tfi", "capture": capture}
    said = "found 81 files, of 9 cameras at 3 planes, expected at most 80, which can be listed; ask for at most 2"
    many = images | {"ticks": "0:60:20"}
    assert asked(http, **many) == (422, f"{said} planes by `ticks`")
    assert http.post("/v1/jobs:batch", json={"jobs": [images | {"ticks": "0:1"}, many]}).status_code == 422
    assert http.get("/v1/jobs").json() == before
    assert asked(http, **images, ticks="0:60:30")[0] == 202


@pytest.mark.parametrize(("most", "ticks"), [(81, None), (80, "0:60:30"), (27, "0:60:60"), (26, None)])
def test_without_planes_as_many_images_are_made_as_can_be_listed(
    http: TestClient, capture: str, monkeypatch: pytest.MonkeyPatch, most: int, ticks: str | None
) -> None:
    """A capture of 60 planes has three images a camera by itself, of three files each."""
    monkeypatch.setattr(results, "MOST", most)
    images = {"type": "images", "method": "tfi", "capture": capture}
    answers = [http.post("/v1/jobs", json=images, headers={"Idempotency-Key": f"images-{most}"}) for _ in range(2)]
    if most < 27:  # one image of each camera
        assert {answer.status_code for answer in answers} == {422}
        return
    first, again = (answer.json() for answer in answers)
    assert first["id"] == again["id"]
    assert first["request"]["ticks"] == again["request"]["ticks"] == ticks


def test_a_dataset_of_more_pictures_than_can_be_listed_is_refused(http: TestClient, job: str) -> None:
    export = {"type": "export", "format": "nerfstudio", "job": job}
    said = "found 83 files, of 8 cameras at 10 planes, expected at most 80, which can be listed; ask for at most 9"
    assert asked(http, **export, frames=10) == (422, f"{said} `frames`")
    assert asked(http, **export)[0] == 422
    assert asked(http, **export, frames=9)[0] == 202
    assert asked(http, **export, frames=1000, from_tick=20, to_tick=29)[0] == 202  # there are no more planes
    assert asked(http, type="export", format="ply", job=job)[0] == 202


def test_what_cannot_be_counted_is_left_to_the_job(http: TestClient, services: Services, capture: str) -> None:
    unread = added(services, "capture", "import")
    services.store.folder.recording(unread).mkdir()
    assert asked(http, type="images", method="tfi", capture=unread)[0] == 202
    unplanned = added(services, "job", "reconstruct", capture=capture, request={"capture": capture})
    assert asked(http, type="export", format="nerfstudio", job=unplanned)[0] == 202


class Worker:
    """Runs the stages of a service, whose processes are only called."""

    def __init__(self, services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
        self.stages = Stages(services.settings, services.store)
        self.made: list[str] = []
        monkeypatch.setattr(self.stages.processes, "run", self._run)

    async def _run(self, entry: Entry, stage: str, arguments: Sequence[str], **_: object) -> None:
        out = Path(arguments[list(arguments).index("--out") + 1])
        out.mkdir(exist_ok=True)
        for name in self.made:
            (out / name).write_text(name)

    def run(self, job: str, stage: str) -> None:
        asyncio.run(self.stages.run(job, stage))


@pytest.fixture
def worker(services: Services, monkeypatch: pytest.MonkeyPatch) -> Worker:
    return Worker(services, monkeypatch)


def test_a_job_warns_of_files_that_are_not_listed(
    http: TestClient, services: Services, capture: str, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = {"type": "images", "method": "tfi", "capture": capture, "ticks": None}
    job = added(services, "job", "images", capture=capture, request=request, queue=TASKS)
    for module in (artefacts, stages):
        monkeypatch.setattr(module, "MOST", 2)
    worker.made = ["a.npy", "b.npy"]
    worker.run(job, "images")
    assert http.get(f"/v1/jobs/{job}").json()["warnings"] == []
    worker.made = ["a.npy", "b.npy", "c.npy"]
    worker.run(job, "images")
    worker.run(job, "images")  # once, however often
    (warning,) = http.get(f"/v1/jobs/{job}").json()["warnings"]
    expected = f"2 of 3 files are listed and can be fetched; all of them lie in jobs/{job}/out of the data folder"
    assert warning == expected
    listed = http.get(f"/v1/jobs/{job}/artefacts").json()["items"]
    assert [one["name"] for one in listed] == ["a.npy", "b.npy"]


def test_a_look_that_cannot_be_kept_says_why(
    http: TestClient, services: Services, worker: Worker, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    def looked() -> str:
        request, queue = {"type": "look", "ticks": 5}, capture_queue("lab3x3")
        job = added(services, "job", "look", rig="lab3x3", request=request, queue=queue, told="failed")
        with pytest.raises(Spike4dgsError):
            worker.run(job, "look")
        return http.get(f"/v1/jobs/{job}").json()["error"]

    assert "recording.json" in looked()  # nothing was recorded
    monkeypatch.setattr(stages, "Recording", SimpleNamespace(open=lambda path: path))
    monkeypatch.setattr(stages, "_keep_look", full)
    assert looked() == "the data folder: found no space left, expected some; free some and resume the job"
