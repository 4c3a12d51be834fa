"""A part of a capture is asked for over REST; ticks that it lacks are refused before anything is queued."""

import numpy as np
import pytest
from fastapi.testclient import TestClient

from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.spikes.layout import PlaneLayout
from rigs.toml import catalog_rig, dump_rig
from server.schemas.job_types import JOB_TYPES
from server.services.services import Services
from server.store.tables import Entry

RIG, PLANES = catalog_rig("lab3x3").scaled(40, 24), 80


@pytest.fixture(scope="module")
def capture(services: Services, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("dats")
    planes = np.zeros((PLANES, PlaneLayout(40, 24).plane_bytes), np.uint8)
    for camera_id in RIG.ids:
        (folder / f"{camera_id}.dat").write_bytes(planes.tobytes())
    (folder / "rig.toml").write_text(dump_rig(RIG))
    entries = services.store.entries
    entry = Entry(entries.dated_id("c"), "capture", "import", entries.now(), {})
    entries.add(entry)
    dats = [f"{camera_id}={folder / camera_id}.dat" for camera_id in RIG.ids]
    import_recording(dats, folder / "rig.toml", services.store.folder.recording(entry.id), ImportOptions(20000))
    return entry.id


def test_a_part_that_is_there_is_queued_as_it_was_asked_for(http: TestClient, capture: str) -> None:
    for first, last in ((0, 80), (79, None), (None, 1), (None, None)):
        asked = {"capture": capture, "from_tick": first, "to_tick": last, "span": 64}
        made = http.post("/v1/jobs", json=asked)
        assert made.status_code == 202, made.text
        kept = http.get(f"/v1/jobs/{made.json()['id']}").json()["request"]
        assert {name: kept[name] for name in asked} == asked


@pytest.mark.parametrize(
    ("ticks", "said"),
    [
        ({"from_tick": 80}, "found the ticks 80 to 80, expected ticks from 0 to 80"),
        ({"to_tick": 81}, "found the ticks 0 to 81"),
        ({"from_tick": -1, "to_tick": 5}, "change `from_tick` or `to_tick`"),
        ({"from_tick": 5, "to_tick": 5}, "found from_tick 5 and to_tick 5, expected the first below the other"),
        ({"from_tick": 6, "to_tick": 5}, "expected the first below the other"),
        ({"from_tick": 1.5}, "integer"),
        ({"from_tick": 10**30}, "9007199254740992"),
        ({"span": 63}, "64"),
    ],
)
def test_ticks_that_make_no_part_are_refused(ticks: dict, said: str, http: TestClient, capture: str) -> None:
    before = http.get("/v1/jobs").json()["items"]
    refused = http.post("/v1/jobs", json={"capture": capture, **ticks})
    assert refused.status_code == 422
    assert said in refused.json()["detail"]
    assert http.get("/v1/jobs").json()["items"] == before


def test_the_requests_have_the_options_of_the_command() -> None:
    for kind in ("reconstruct", "export"):
        assert {"from_tick", "to_tick"} <= set(JOB_TYPES[kind].model_fields)
