"""Captures of 1 to 1,000,000 planes over REST: manifest, pictures, figures, and jobs expected by their length."""

import io
import json
import os
import tracemalloc

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.spikes.layout import PlaneLayout
from rigs.toml import catalog_rig, dump_rig
from server.services import previews
from server.services.forecast import Forecast
from server.services.services import Services
from server.store.tables import Entry

RIG = catalog_rig("lab3x3").scaled(64, 40)
RIG = RIG.only(["cam00"])
PLANE = PlaneLayout(64, 40).plane_bytes
MIDDLE = 200  # planes that pictures are made of
FLAT_BYTES = 24 << 20
LENGTHS = [1, 2, 63, 64, 65, 100_000, pytest.param(1_000_000, marks=pytest.mark.slow)]


def captured(services: Services, planes: int, folder) -> str:
    """Import a capture that is dark but for its middle, from a sparse file."""
    with (folder / "cam00.dat").open("wb") as file:
        os.truncate(file.fileno(), planes * PLANE)
        first = max(0, planes // 2 - MIDDLE // 2)
        file.seek(first * PLANE)
        file.write(bytes([0x0F]) * (PLANE * min(MIDDLE, planes - first)))
    (folder / "rig.toml").write_text(dump_rig(RIG))
    entries = services.store.entries
    entry = Entry(entries.dated_id("c"), "capture", "import", entries.now(), {})
    entries.add(entry)
    dats = [f"cam00={folder / 'cam00.dat'}"]
    import_recording(dats, folder / "rig.toml", services.store.folder.recording(entry.id), ImportOptions(20000))
    return entry.id


@pytest.fixture
def opened(monkeypatch):
    """The recordings whose manifest was read for a picture."""
    seen, read = [], previews.Recording.open
    monkeypatch.setattr(previews.Recording, "open", classmethod(lambda cls, path: seen.append(path) or read(path)))
    return seen


@pytest.mark.parametrize("planes", LENGTHS)
def test_a_capture_of_any_length_is_shown(planes, http: TestClient, services: Services, tmp_path, opened) -> None:
    capture = captured(services, planes, tmp_path)
    tracemalloc.start()
    manifest = http.get(f"/v1/captures/{capture}/manifest")
    assert [(camera["id"], camera["planes"]) for camera in manifest.json()["cameras"]] == [("cam00", planes)]
    assert len(manifest.content) < 10_000  # digests are not for people
    (figures,) = http.get(f"/v1/captures/{capture}/figures").json()["cameras"]
    assert figures["planes"] == min(planes, MIDDLE)
    picture = np.asarray(Image.open(io.BytesIO(http.get(f"/v1/captures/{capture}/preview/cam00").content)))
    assert picture.shape == (40, 64)
    assert set(picture[:, :4].flat) == {255}
    assert set(picture[:, 4:8].flat) == {0}
    assert http.get(f"/v1/captures/{capture}/preview").status_code == 200
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < FLAT_BYTES
    assert len(opened) == 1


def test_pictures_of_a_finished_job_read_the_manifest_once(
    http: TestClient, services: Services, tmp_path, opened
) -> None:
    capture = captured(services, 1000, tmp_path)
    entries = services.store.entries
    job = Entry(entries.dated_id("j"), "job", "reconstruct", entries.now(), {}, capture=capture)
    entries.add(job)
    run = services.store.folder.run(job.id)
    run.mkdir(parents=True)
    (run / "viewer.json").write_text(json.dumps({"white": 0.5}))
    services.store.artefacts.catalogue(job.id, run, iter(["viewer.json"]))
    shown = {http.get(f"/v1/jobs/{job.id}/pictures/cam00", params={"plane": k}).content for k in (0, 450, 999)}
    assert len(shown) == 2  # dark before and after
    assert len(opened) == 1
    recording = services.store.folder.recording(capture)
    text = (recording / "recording.json").read_text()
    (recording / "recording.json").write_text(text.replace('"tick_rate_hz": 20000', '"tick_rate_hz": 40000'))
    assert http.get(f"/v1/jobs/{job.id}/pictures").json()["tick_rate_hz"] == 40000  # what is written anew is read anew
    assert len(opened) == 2


def test_the_length_of_a_capture_is_read_once_it_is_there(http: TestClient, services: Services, tmp_path) -> None:
    planes_of = Forecast(services.store, services.engine)._planes_of  # what expected seconds follow
    entries = services.store.entries
    coming = Entry(entries.dated_id("c"), "capture", "import", entries.now(), {})
    entries.add(coming)
    assert planes_of(coming.id) is None
    made = services.store.folder.recording(captured(services, 40_000, tmp_path))
    made.rename(services.store.folder.recording(coming.id))
    assert planes_of(coming.id) == 40_000
    (services.store.folder.recording(coming.id) / "recording.json").unlink()
    assert planes_of(coming.id) == 40_000  # the planes of a capture never change
