"""Pictures of a finished reconstruction's cameras over REST, without a worker."""

import io
import json

import numpy as np
import pytest
from fastapi.testclient import TestClient
from maintenance.entries import added, imported
from PIL import Image

from reconstruction.images.catalogue import method
from reconstruction.report.display import grey
from rigs.toml import catalog_rig
from server.services.services import Services

RIG = catalog_rig("lab3x3").scaled(40, 24)
PLANES, WHITE = 80, 0.8


@pytest.fixture(scope="module")
def capture(services: Services, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A capture in which an edge moves a column to the right every four planes, from another place in each camera."""
    spikes = np.zeros((len(RIG.ids), PLANES, 24, 40), np.uint8)
    for number, planes in enumerate(spikes):
        for plane in range(0, PLANES, 2):
            planes[plane, :, number + plane // 4 :] = 1
    return imported(services, RIG, spikes, tmp_path_factory.mktemp("dats"))


def reconstructed(services: Services, capture: str, **fields: str) -> str:
    """Add a job with a scene for the viewer; a job without a queue is done."""
    job = added(services, "job", "reconstruct", capture=capture, **fields)
    run = services.store.folder.run(job)
    run.mkdir(parents=True)
    (run / "viewer.json").write_text(json.dumps({"white": WHITE}))
    services.store.artefacts.catalogue(job, run, iter(["viewer.json"]))
    return job


def test_every_camera_is_shown_as_the_method_sees_it(http: TestClient, services: Services, capture: str) -> None:
    job = reconstructed(services, capture)
    about = http.get(f"/v1/jobs/{job}/pictures").json()
    assert about == {
        "method": "adaptive",
        "capture": capture,
        "cameras": list(RIG.ids),
        "planes": PLANES,
        "tick_rate_hz": 20000.0,
        "white": WHITE,
    }
    recording = services.previews.recording(capture)
    seen = set()
    for camera_id, plane in (("cam00", 40), ("cam11", 40), ("cam11", 79)):
        answer = http.get(f"/v1/jobs/{job}/pictures/{camera_id}", params={"plane": plane})
        assert answer.headers["content-type"] == "image/png"
        shown = np.asarray(Image.open(io.BytesIO(answer.content)))
        expected = method("adaptive")(recording.stream(camera_id), plane).intensity
        np.testing.assert_array_equal(shown, grey(expected, WHITE))
        seen.add(answer.content)
        known = {"If-None-Match": answer.headers["ETag"]}
        assert http.get(answer.request.url, headers=known).status_code == 304
    assert len(seen) == 3


def test_what_there_is_not_is_refused_in_a_line(http: TestClient, services: Services, capture: str) -> None:
    job = reconstructed(services, capture)
    running = reconstructed(services, capture, queue="reconstructions")
    bare = added(services, "job", "reconstruct", capture=capture)
    lost = reconstructed(services, "c20260101-120000-0a1b2c3d")
    for asked, status, words in (
        (f"{job}/pictures/cam99?plane=3", 404, "found no camera cam99"),
        (f"{job}/pictures/cam11?plane={PLANES}", 422, f"found the plane {PLANES}, expected one of 0 to {PLANES - 1}"),
        (f"{job}/pictures/cam11?plane=-1", 422, ""),
        (f"{job}/pictures/cam11", 422, ""),
        (f"{running}/pictures/cam11?plane=3", 409, "held-out camera is not scored yet"),
        (f"{running}/pictures", 409, "expected it done"),
        (f"{bare}/pictures", 404, "found no artefact viewer.json"),
        (f"{lost}/pictures/cam11?plane=3", 404, "found no capture c20260101-120000-0a1b2c3d"),
    ):
        answer = http.get(f"/v1/jobs/{asked}")
        assert answer.status_code == status, asked
        assert words in answer.json()["detail"], answer.json()
