"""Imports, previews, manifests and the state of rigs over REST, without a worker."""

import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from acquisition.recording.compaction import compact, restore
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from rigs.exchange.nerfstudio import dump_transforms
from rigs.toml import catalog_rig, dump_rig
from server.app import create_app
from server.errors import StateError
from server.services import announcer
from server.services.queue import Queue
from server.services.services import Services
from server.settings import ServiceSettings
from server.store.tables import Entry
from server.work.commands import import_arguments, look_arguments, preflight_arguments

RIG = catalog_rig("lab3x3").scaled(40, 24)
PLANES = 60


def planes_of(number: int) -> np.ndarray:
    """Camera `number` is lit from its column `number` on: one spike every second plane."""
    planes = np.zeros((PLANES, 24, 40), dtype=np.uint8)
    planes[::2, :, number:] = 1
    return pack(planes, PlaneLayout(40, 24))


@pytest.fixture(scope="module")
def capture_id(services: Services, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A capture as a worker leaves it."""
    folder, store = tmp_path_factory.mktemp("dats"), services.store
    for number, camera_id in enumerate(RIG.ids):
        (folder / f"{camera_id}.dat").write_bytes(planes_of(number).tobytes())
    (folder / "rig.toml").write_text(dump_rig(RIG))
    entry = add(services, "capture", "import")
    dats = [f"{camera_id}={folder / camera_id}.dat" for camera_id in RIG.ids]
    import_recording(dats, folder / "rig.toml", store.folder.recording(entry.id), ImportOptions(20000))
    return entry.id


def add(services: Services, kind: Any, what: str, **fields: Any) -> Entry:
    entries = services.store.entries
    entry = Entry(entries.dated_id(kind[0]), kind, what, entries.now(), fields.pop("request", {}), **fields)
    entries.add(entry)
    return entry


def uploaded(http: TestClient, data: bytes, name: str = "a") -> str:
    made = http.post("/v1/uploads", json={"name": name, "bytes": len(data)}).json()["id"]
    assert http.patch(f"/v1/uploads/{made}", content=data, headers={"Upload-Offset": "0"}).status_code == 200
    assert http.post(f"/v1/uploads/{made}/commit").status_code == 200
    return made


def refused(response, status: int, *words: str) -> None:
    assert (response.status_code, response.headers["content-type"]) == (status, "application/problem+json")
    for word in words:
        assert word in response.json()["detail"]


# Imports


@pytest.fixture(scope="module")
def dats(http: TestClient) -> dict[str, str]:
    return {camera_id: uploaded(http, b"spikes", f"../{camera_id}.dat") for camera_id in RIG.ids}


@pytest.fixture(scope="module")
def cameras(http: TestClient) -> str:
    return uploaded(http, dump_rig(RIG).encode(), "RIG.toml")


def test_an_import_is_queued_with_its_cameras_file(
    http: TestClient, services: Services, dats: dict[str, str], cameras: str
) -> None:
    body = {"uploads": dats, "cameras": cameras, "tick_rate_hz": 20000, "align": True, "name": "from the shelf"}
    answer = http.post("/v1/captures:import", json=body, headers={"Idempotency-Key": "once"})
    capture = answer.json()
    assert (answer.status_code, capture["type"], capture["status"]) == (202, "import", "queued")
    assert http.post("/v1/captures:import", json=body, headers={"Idempotency-Key": "once"}).json() == capture
    assert http.get(answer.headers["Location"]).json() == capture
    (entry,) = services.store.entries.find([capture["id"]])
    assert entry.queue == "tasks"
    staged = services.store.folder.entry(entry.id) / entry.request["cameras"]
    assert staged.read_text() == dump_rig(RIG)
    paths = [Path(f"/u/{n}") for n in range(9)]
    assert import_arguments(entry.request, paths, Path("c.toml"), Path("rec"), 256_000_000) == [
        *("import", *(text for n, name in enumerate(RIG.ids) for text in ("--dat", f"{name}=/u/{n}"))),
        *("--cameras", "c.toml", "--format", "vidar", "--tick-rate", "20000.0"),
        *("--keep-free", "256", "--align", "--out", "rec"),
    ]
    refused(http.delete(f"/v1/uploads/{dats['cam00']}"), 409, capture["id"])
    refused(http.get(f"{answer.headers['Location']}/preview"), 409, "queued")
    refused(http.get(f"{answer.headers['Location']}/manifest"), 409, "queued")
    assert http.post(f"{answer.headers['Location']}/cancel").json()["status"] == "cancelled"
    refused(http.post(f"{answer.headers['Location']}/cancel"), 409, "cancelled")


def test_uploads_are_free_as_soon_as_their_import_has_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(announcer, "_LOOK_S", 3600)  # nobody is told that the import has ended
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as http:
        dats = [uploaded(http, b"spikes") for _ in RIG.ids]
        body = {"uploads": dats, "cameras": {"rig": "lab3x3"}, "tick_rate_hz": 20000}
        capture = http.post("/v1/captures:import", json=body).json()["id"]
        refused(http.delete(f"/v1/uploads/{dats[0]}"), 409, capture)
        assert http.post(f"/v1/captures/{capture}/cancel").json()["status"] == "cancelled"
        assert http.delete(f"/v1/uploads/{dats[0]}").status_code == 204


def test_transforms_and_rigs_are_cameras_too(http: TestClient, services: Services, dats: dict[str, str]) -> None:
    transforms = uploaded(http, dump_transforms(RIG.cameras).encode())
    for chosen, name, rig in ((transforms, "cameras.json", None), ({"rig": "lab3x3"}, "cameras.toml", "lab3x3")):
        body = {"uploads": list(dats.values()), "cameras": chosen, "tick_rate_hz": 20000, "bit_order": "msb"}
        answer = http.post("/v1/captures:import", json=body)
        assert (answer.status_code, answer.json()["rig"]) == (202, rig)
        (entry,) = services.store.entries.find([answer.json()["id"]])
        assert (entry.request["cameras"], entry.request["ids"]) == (name, None)
        http.post(f"/v1/captures/{entry.id}/cancel")


@pytest.mark.parametrize(
    ("change", "status", "word"),
    [
        ({"uploads": {}}, 422, "uploads"),
        ({"uploads": {"../cam00": "u"}}, 422, "uploads"),
        ({"uploads": {"--out": "u"}}, 422, "uploads"),
        ({"uploads": ["u20240101-000000-00000000"]}, 422, "no upload"),
        ({"uploads": ["../../etc/passwd"]}, 422, "no upload"),
        ({"cameras": "/etc/passwd"}, 422, "no upload"),
        ({"cameras": {"rig": "../lab3x3"}}, 422, "no rig"),
        ({"cameras": {"rig": "lab3x3", "path": "/"}}, 422, "cameras"),
        ({"tick_rate_hz": 0}, 422, "tick_rate_hz"),
        ({"tick_rate_hz": "NaN"}, 422, "tick_rate_hz"),
        ({"size": [40]}, 422, "size"),
        ({"size": [40, 25]}, 422, "40x24"),
        ({"format": "m1k40", "bit_order": "lsb"}, 422, "fixes them"),
        ({"format": "m1k40"}, 422, "1000x1000"),
        ({"out": "/tmp/x"}, 422, "out"),
    ],
    ids=str,
)
def test_an_import_that_does_not_fit_is_refused(
    http: TestClient, services: Services, dats: dict[str, str], cameras: str, change: dict, status: int, word: str
) -> None:
    before = sorted((services.store.folder.path / "entries").iterdir())
    body = {"uploads": dats, "cameras": cameras, "tick_rate_hz": 20000} | change
    refused(http.post("/v1/captures:import", json=body), status, word)
    assert sorted((services.store.folder.path / "entries").iterdir()) == before


def test_what_was_uploaded_must_fit(http: TestClient, dats: dict[str, str], cameras: str) -> None:
    def post(**change: object):
        return http.post(
            "/v1/captures:import", json={"uploads": dats, "cameras": cameras, "tick_rate_hz": 20000} | change
        )

    still_open = http.post("/v1/uploads", json={"name": "a", "bytes": 5}).json()["id"]
    refused(post(uploads=dats | {"cam00": still_open}), 409, "open, expected it committed")
    refused(post(cameras=still_open), 409, "open")
    refused(post(uploads=dats | {"cam00": dats["cam01"]}), 422, "twice")
    refused(post(uploads=list(dats.values())[:8]), 422, "found 8 uploads")
    refused(post(uploads=dict(list(dats.items())[:8])), 422, "cam22")
    refused(post(cameras=uploaded(http, b"no cameras", "my rig")), 422, "my rig", "not TOML")
    refused(post(cameras=uploaded(http, b'{"frames": []}', "my frames")), 422, "my frames")
    pixels = dump_rig(RIG).replace('id = "cam00"', 'id = "cam00"\npixels = "cameras.toml"')
    refused(post(cameras=uploaded(http, pixels.encode())), 422, "found pixel calibrations")


# Previews and manifests


def test_a_preview_shows_every_camera_in_its_place(http: TestClient, capture_id: str) -> None:
    answer = http.get(f"/v1/captures/{capture_id}/preview")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    sheet = np.asarray(Image.open(io.BytesIO(answer.content)))
    assert sheet.shape == (3 * 28 - 4, 3 * 44 - 4)
    cam22 = sheet[56:80, 88:128]
    assert (cam22[20, :8] == 0).all()
    assert (cam22[20, 8:] == 255).all()
    tag = answer.headers["etag"]
    for known in (tag, f'"x", W/{tag}', "*"):
        again = http.get(f"/v1/captures/{capture_id}/preview", headers={"If-None-Match": known})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert http.get(f"/v1/captures/{capture_id}/preview", headers={"If-None-Match": '"x"'}).content == answer.content


def test_a_preview_of_one_camera_is_in_its_size(http: TestClient, services: Services, capture_id: str) -> None:
    answer = http.get(f"/v1/captures/{capture_id}/preview/cam12")
    picture = np.asarray(Image.open(io.BytesIO(answer.content)))
    assert picture.shape == (24, 40)
    assert (picture == np.where(np.arange(40) < 5, 0, 255)).all()
    assert (services.store.folder.entry(capture_id) / "preview-cam12.png").read_bytes() == answer.content
    for camera_id in ("cam77", "..%2fcam12", "cam12.png"):
        assert http.get(f"/v1/captures/{capture_id}/preview/{camera_id}").status_code == 404


def test_a_manifest_tells_what_there_is_and_whether_it_was_verified(
    http: TestClient, services: Services, capture_id: str
) -> None:
    found = http.get(f"/v1/captures/{capture_id}/manifest").json()
    assert (found["status"], found["reason"], found["trigger"], found["verified"]) == ("complete", None, "import", None)
    camera = found["cameras"][4]
    assert (camera["id"], camera["planes"], camera["bytes"]) == ("cam11", PLANES, PLANES * 120)
    assert camera["sha256"] == hashlib.sha256(planes_of(4).tobytes()).hexdigest()
    assert (camera["drops"], camera["gaps_total"]) == ({"device": 0, "link": 0, "ring": 0, "disk": 0}, 0)
    job = add(services, "job", "verify", capture=capture_id, request={"type": "verify", "capture": capture_id})
    out = services.store.folder.out(job.id)
    out.mkdir(parents=True)
    damages = [{"file": "cam11.dat", "block": 3, "reason": "planes are not the recorded ones"}]
    (out / "result.json").write_text(json.dumps({"sound": False, "damages": damages}))
    verified = http.get(f"/v1/captures/{capture_id}/manifest").json()["verified"]
    assert (verified["job"], verified["sound"], verified["damages"]) == (job.id, False, damages)


def test_a_damaged_recording_is_said(http: TestClient, services: Services, capture_id: str) -> None:
    folder = services.store.folder.recording(capture_id)
    whole = (folder / "cam21.dat").read_bytes()
    (folder / "cam21.dat").write_bytes(whole[:-7])
    refused(http.get(f"/v1/captures/{capture_id}/preview/cam21"), 409, "cam21.dat", "verify it")
    assert str(folder) not in http.get(f"/v1/captures/{capture_id}/preview/cam21").json()["detail"]
    (folder / "cam21.dat").write_bytes(whole)
    assert http.get(f"/v1/captures/{capture_id}/preview/cam21").status_code == 200


def test_a_compact_capture_is_shown_as_before(http: TestClient, services: Services, capture_id: str) -> None:
    folder, kept = services.store.folder.recording(capture_id), services.store.folder.entry(capture_id)
    manifest, preview = (f"/v1/captures/{capture_id}/{name}" for name in ("manifest", "preview/cam02"))
    before = http.get(manifest).json(), http.get(preview).content
    compact(folder)
    (kept / "preview-cam02.png").unlink()
    assert (http.get(manifest).json(), http.get(preview).content) == before
    data = (folder / "cam02.compact").read_bytes()
    (folder / "cam02.compact").write_bytes(data[:-9] + bytes(9))
    (kept / "preview-cam02.png").unlink()
    refused(http.get(preview), 409, "cam02.compact: block 0", "verify it")
    assert str(folder) not in http.get(preview).json()["detail"]
    (folder / "cam02.compact").write_bytes(data)
    restore(folder)
    assert http.get(preview).content == before[1]


# Rigs


def test_a_rig_without_a_worker_says_so(http: TestClient) -> None:
    found = http.get("/v1/rigs/lab3x3/status").json()
    assert (found["worker"], found["busy"], found["preflight"], found["look"]) == (False, None, None, None)
    assert found["disk"]["bytes_per_s"] == 9 * 12500 * 20000
    assert found["disk"]["seconds"] == pytest.approx(found["disk"]["free_bytes"] / 2.25e9)
    assert [camera["connected"] for camera in found["cameras"]] == [None] * 9
    refused(http.get("/v1/rigs/lab3x3/look.png"), 404, "POST /v1/rigs/lab3x3/look")
    for path in ("status", "look.png"):
        refused(http.get(f"/v1/rigs/lab9x9/{path}"), 404, "lab3x3")


def test_a_rig_does_one_thing_at_a_time(tmp_path: Path) -> None:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as http:
        answer = http.post("/v1/rigs/lab3x3/preflight")
        job = answer.json()
        assert (answer.status_code, job["type"], job["rig"], job["status"]) == (202, "preflight", "lab3x3", "queued")
        assert http.get(answer.headers["Location"]).json() == job
        assert http.get("/v1/rigs/lab3x3/status").json()["busy"]["id"] == job["id"]
        refused(http.post("/v1/rigs/lab3x3/look"), 409, job["id"])
        refused(http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5}), 409, job["id"])
        assert len(list((tmp_path / "jobs").iterdir())) == 1
        http.post(f"/v1/jobs/{job['id']}/cancel")
        capture = http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5}).json()
        refused(http.post("/v1/rigs/lab3x3/look", json={"ticks": 50}), 409, capture["id"])
        refused(http.post("/v1/rigs/lab3x3/preflight"), 409, capture["id"])
        for word in ("stop", "save"):
            refused(http.post(f"/v1/rigs/nosuch/captures/{capture['id']}/{word}"), 404, "of rig lab3x3, not nosuch")
        refused(http.post(f"/v1/captures/{capture['id']}/finalise"), 409, "queued")
        http.post(f"/v1/rigs/lab3x3/captures/{capture['id']}/stop")
        refused(http.post(f"/v1/captures/{capture['id']}/finalise"), 409, "found no planes")
        looks = []
        for _ in range(3):
            looks.append(http.post("/v1/rigs/lab3x3/look", json={"ticks": 50}).json()["id"])
            http.post(f"/v1/jobs/{looks[-1]}/cancel")
        found = [item["id"] for item in http.get("/v1/jobs?type=look").json()["items"]]
        assert found == looks[-1:]
        refused(http.post("/v1/rigs/lab3x3/look", json={"ticks": 0}), 422, "ticks")
        refused(http.post("/v1/rigs/lab3x3/preflight", json={"disk_seconds": 1e9}), 422, "disk_seconds")
        refused(http.post("/v1/jobs", json={"type": "preflight"}), 422, "preflight")


def test_arguments_of_what_looks_at_a_rig() -> None:
    assert preflight_arguments({"type": "preflight", "disk_seconds": 2.0}, "lab3x3", "usb:", Path("d")) == [
        *("preflight", "--rig", "lab3x3", "--devices", "usb:", "--out", "d", "--disk-seconds", "2.0", "--json")
    ]
    plain = look_arguments({"type": "look", "ticks": 7}, "lab3x3", "usb:", Path("r"))
    assert plain == ["record", "--rig", "lab3x3", "--devices", "usb:", "--ticks", "7", "--out", "r"]
    assert look_arguments({"ticks": 7}, "r", "mock:fan?seed=1", Path("r"))[4] == "mock:fan?seed=1&truth_every=7"


# What is used, and what is told


@pytest.mark.parametrize(
    ("kind", "request_"),
    [("calibrate", {"flat": "c-flat", "dark": "c-dark"}), ("render", {"job": "j-run", "cameras": "u-path"})],
)
def test_what_a_queued_task_was_given_is_in_use(services: Services, kind: str, request_: dict[str, str]) -> None:
    queue, entry = Queue(services.store, services.engine), add(services, "job", kind, request=request_, queue="tasks")
    used = [name for key, name in request_.items() if key != "flat"]  # the flat is the capture of its entry
    for name in used:
        with pytest.raises(StateError, match=f"found {name} in use by {entry.id}"):
            queue.expect_unused(name)
    services.store.entries.remove(entry.id)
    for name in used:
        queue.expect_unused(name)


def test_a_capture_that_would_end_before_its_trigger_is_refused(http: TestClient) -> None:
    for ticks, status in ((100, 422), (101, 202)):
        answer = http.post("/v1/rigs/lab3x3/captures", json={"ticks": ticks, "pre_trigger_ms": 5})
        assert answer.status_code == status
    made = answer.json()["id"]
    http.post(f"/v1/rigs/lab3x3/captures/{made}/stop")


def test_only_what_has_a_pre_trigger_is_saved(http: TestClient) -> None:
    made = http.post("/v1/rigs/lab3x3/captures", json={"until_stopped": True}).json()["id"]
    refused(http.post(f"/v1/rigs/lab3x3/captures/{made}/save"), 409, "without pre-trigger")
    http.post(f"/v1/rigs/lab3x3/captures/{made}/stop")
