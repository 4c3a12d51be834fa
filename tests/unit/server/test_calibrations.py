"""Calibrations without a worker: versions, who may change the current one, and rig files from outside."""

import json
import re
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from rigs.rig import Calibration
from rigs.toml import catalog_rig, dump_rig, load_rig
from server.app import create_app
from server.errors import PreconditionError, RigMismatchError
from server.etags import matches
from server.settings import ServiceSettings
from server.store.rig_files import fitted, with_pixels_of
from server.store.store import Store
from server.store.tables import Found
from server.work.commands import task_arguments

LAB = catalog_rig("lab3x3")
PATH = "/v1/rigs/lab3x3/calibration"
MEASURED = replace(LAB, poses="nominal", calibration=Calibration("2026-11-21", 0.25, 0.01))


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as client:
        yield client


@pytest.fixture
def store(http: TestClient) -> Store:
    return http.app.state.services.store  # type: ignore[attr-defined]


def put(http: TestClient, body: object, etag: str | None = None):
    return http.put(PATH, json=body, headers={"If-Match": etag or http.get(PATH).headers["ETag"]})


def keep(store: Store, job: str | None, *, apply: bool = True, document: str = "poses = 'calibrated'"):
    return store.calibrations.add("lab3x3", Found("natural", {}, job), lambda _: document, apply=apply)


def test_a_rig_begins_as_it_was_drawn(http: TestClient) -> None:
    found = http.get(PATH)
    assert found.headers["ETag"] == '"lab3x3-0"'
    body = found.json()
    assert (body["version"], body["revision"], body["source"], body["created"]) == (0, 0, "nominal", None)
    assert http.get("/v1/rigs/lab3x3/calibrations").json() == {"items": []}
    assert http.get("/v1/rigs/lab3x3/calibrations/0").json()["sha256"] == body["sha256"]
    assert http.get("/v1/rigs/lab3x3/calibrations/0/rig.toml").text == dump_rig(LAB)
    assert http.get("/v1/rigs/lab3x3").json()["calibration"] == 0
    for path in ("calibrations/1", "calibrations/1/rig.toml", "calibrations/0/picture"):
        assert http.get(f"/v1/rigs/lab3x3/{path}").status_code == 404
    for rig in ("lab9x9", "..%2f..%2fetc"):
        assert http.get(f"/v1/rigs/{rig}/calibration").status_code == 404


def test_what_has_not_changed_is_not_sent_again(http: TestClient) -> None:
    for header, status in (('"lab3x3-0"', 304), ('W/"lab3x3-0"', 304), ('"a", "lab3x3-0"', 304), ('"lab3x3-1"', 200)):
        found = http.get(PATH, headers={"If-None-Match": header})
        assert (found.status_code, found.headers["ETag"]) == (status, '"lab3x3-0"')
        assert bool(found.content) == (status == 200)


def test_a_change_says_what_it_changes(http: TestClient, tmp_path: Path) -> None:
    bare = http.put(PATH, json={"version": 0})
    assert (bare.status_code, bare.headers["content-type"]) == (428, "application/problem+json")
    for stale in ('"lab3x3-1"', 'W/"lab3x3-0"', "lab3x3-0", ""):
        assert put(http, {"toml": dump_rig(MEASURED)}, stale or '""').status_code == 412
    uploaded = put(http, {"toml": dump_rig(MEASURED)})
    assert (uploaded.status_code, uploaded.headers["ETag"]) == (200, '"lab3x3-1"')
    assert (uploaded.json()["version"], uploaded.json()["source"]) == (1, "uploaded")
    assert uploaded.json()["residual_px"] == 0.25
    assert put(http, {"version": 0}, '"lab3x3-0"').status_code == 412
    rig = http.get("/v1/rigs/lab3x3").json()
    assert (rig["calibration"], rig["poses"]) == (1, "nominal")
    file = tmp_path / "rigs/lab3x3/calibration.toml"
    assert file.read_text() == http.get("/v1/rigs/lab3x3/calibrations/1/rig.toml").text
    assert put(http, {"version": 0}).json()["revision"] == 2
    assert not file.exists()
    assert http.get("/v1/rigs/lab3x3").json()["poses"] == "calibrated"
    assert put(http, {"version": 1}, "*").json()["revision"] == 3
    assert file.exists()
    assert put(http, {"version": 7}).status_code == 422
    assert http.get(PATH).headers["ETag"] == '"lab3x3-3"'


def test_of_many_changes_of_one_state_one_wins(http: TestClient) -> None:
    bodies = [{"version": 0}, {"toml": dump_rig(MEASURED)}] * 4
    with ThreadPoolExecutor(8) as pool:
        codes = list(pool.map(lambda body: put(http, body, '"lab3x3-0"').status_code, bodies))
    assert sorted(codes) == [200] + [412] * 7
    assert http.get(PATH).json()["revision"] == 1


def hostile() -> dict[str, str]:
    text = dump_rig(MEASURED)
    first = LAB.cameras[0]
    line = f"fx = {first.fx}"
    assert line in text
    return {
        "NaN": text.replace(line, "fx = nan"),
        "infinity": text.replace(line, "fx = inf"),
        "negative focal": text.replace(line, "fx = -900.0"),
        "digits": text.replace(line, f"fx = {'9' * 5000}"),
        "pixels": text.replace(line, f'pixels = "../../../etc/passwd"\n{line}'),
        "pixels beside": text.replace(line, f'pixels = "calibration.toml"\n{line}'),
        "unknown field": text.replace(line, f'include = "/etc/passwd"\n{line}'),
        "huge quaternion": re.sub(r"quat_wxyz = \[[^]]*\]", "quat_wxyz = [1e308, 1e308, 1e308, 1e308]", text),
        "far away": re.sub(r"translation_m = \[[^]]*\]", "translation_m = [1e308, 1e308, 1e308]", text),
        "no quaternion": text.replace("quat_wxyz", "quat"),
        "a camera twice": text.replace('"cam01"', '"cam00"'),
        "a camera less": dump_rig(LAB.only(LAB.ids[:6])),
        "another size": dump_rig(LAB.scaled(200, 125)),
        "another rate": dump_rig(replace(LAB, tick_rate_hz=10_000.0)),
        "another name of a camera": text.replace('"cam00"', '"x/../../y"'),
        "a line in an id": text.replace('"cam00"', '"cam\\u000a00"'),
        "nested": "a=" + "[" * 30_000,
        "dotted": "a." * 30_000 + "b = 1",
        "bad calibration": text.replace("2026-11-21", "yesterday"),
        "no TOML": "\x00\x01",
        "huge": "#" * 64_001,
        "empty": "",
    }


@pytest.mark.parametrize("fault", hostile())
def test_a_rig_file_from_outside_is_checked(http: TestClient, tmp_path: Path, fault: str) -> None:
    answer = put(http, {"toml": hostile()[fault]})
    assert (answer.status_code, answer.headers["content-type"]) == (422, "application/problem+json"), answer.text
    assert "\n" not in answer.json()["detail"]
    assert len(answer.json()["detail"]) < 500
    assert http.get(PATH).json()["revision"] == 0
    assert not (tmp_path / "rigs/lab3x3/calibration.toml").exists()


def test_a_rig_file_keeps_the_names_of_the_rig(http: TestClient) -> None:
    other = replace(MEASURED, name="my rig", cameras=MEASURED.cameras[::-1])
    assert put(http, {"toml": dump_rig(other)}).status_code == 200
    assert http.get("/v1/rigs/lab3x3/calibrations/1/rig.toml").text == dump_rig(MEASURED)


@pytest.mark.parametrize(
    "body",
    [
        *({}, {"capture": "c", "ticks": 5}, {"flat": "c"}, {"flat": "c", "dark": "d", "ticks": 5}, {"ticks": 0}),
        *({"capture": "c", "board": "../x"}, {"flat": "c", "dark": "d", "board": "charuco:6x4:100:67.5:DICT_4X4_50"}),
        *({"capture": "c"}, {"capture": "../../etc"}, {"capture": "c", "path": "/etc"}),
    ],
    ids=str,
)
def test_a_calibration_that_cannot_be_is_refused(http: TestClient, body: dict[str, object]) -> None:
    assert http.post("/v1/rigs/lab3x3/calibrations", json=body).status_code == 422
    assert http.get("/v1/jobs").json()["items"] == []
    assert http.get("/v1/captures").json()["items"] == []


@pytest.mark.parametrize("body", [{}, {"version": 0, "toml": "x"}, {"version": -1}, {"version": 2**40}, {"file": "x"}])
def test_a_choice_that_cannot_be_is_refused(http: TestClient, body: dict[str, object]) -> None:
    assert put(http, body).status_code == 422


def test_what_a_job_finds_is_kept_and_applied_once(store: Store) -> None:
    first = keep(store, "j1")
    assert store.calibrations.apply("lab3x3", 0).revision == 2
    assert keep(store, "j1", document="another") == first  # the step was done again
    assert store.calibrations.current("lab3x3")[0].version == 0
    assert keep(store, "j2", apply=False).version == 2
    assert store.calibrations.current("lab3x3")[0].revision == 2
    with pytest.raises(PreconditionError, match="revision 2, expected 1"):
        store.calibrations.apply("lab3x3", 1, expected=1)
    assert [one.version for one in store.calibrations.of("lab3x3")] == [2, 1]
    assert store.calibrations.of("other") == []


def test_a_file_that_was_never_written_is_mended(store: Store) -> None:
    path = store.rig_files.path("lab3x3")
    keep(store, "j1", document="poses = 'calibrated'\n")
    assert not path.exists()  # as if the process had died between storing and writing
    assert store.rig_files.refresh("lab3x3").read_text() == "poses = 'calibrated'\n"
    store.calibrations.apply("lab3x3", 0)
    assert path.exists()
    store.rig_files.refresh("lab3x3")
    assert not path.exists()


def test_only_the_same_cameras_fit() -> None:
    serials = replace(LAB, cameras=tuple(replace(c, serial=f"S{c.id}") for c in LAB.cameras))
    unnamed = replace(MEASURED, cameras=tuple(replace(c, serial="") for c in LAB.cameras))
    assert fitted(unnamed, serials).cameras[4].serial == "Scam11"
    assert fitted(unnamed, serials).calibration == MEASURED.calibration
    other = replace(MEASURED, cameras=(replace(LAB.cameras[0], serial="X"), *LAB.cameras[1:]))
    with pytest.raises(RigMismatchError, match=r"cam00: found the serial 'X', expected 'Scam00'"):
        fitted(other, serials)
    with pytest.raises(RigMismatchError, match="cam00: found a camera of 200x125 pixels, expected 400x250"):
        fitted(LAB.scaled(200, 125), LAB)
    with pytest.raises(RigMismatchError, match="cam20: found a camera of none"):
        fitted(LAB.only(LAB.ids[:6]), LAB)
    with pytest.raises(RigMismatchError, match="cam20: found a camera of 400x250 pixels, expected none"):
        fitted(LAB, LAB.only(LAB.ids[:6]))


def test_pixel_maps_are_named_by_what_is_in_them(store: Store, tmp_path: Path) -> None:
    one, other = tmp_path / "one.npz", tmp_path / "other.npz"
    one.write_bytes(b"one")
    other.write_bytes(b"other")
    rigs = [replace(LAB, cameras=(replace(LAB.cameras[0], pixels=path), *LAB.cameras[1:])) for path in (one, other)]
    kept = [store.rig_files.adopt_pixels("lab3x3", rig) for rig in rigs]
    paths = [rig.cameras[0].pixels for rig in kept]
    assert len({*paths}) == 2
    assert [path and path.read_bytes() for path in paths] == [b"one", b"other"]
    assert with_pixels_of(LAB, kept[0]).cameras[0].pixels == paths[0]
    assert with_pixels_of(kept[1], LAB).cameras[0].pixels == paths[1]
    file = store.folder.rig("lab3x3") / "rig.toml"
    file.write_text(dump_rig(kept[0]))
    assert load_rig(file).cameras[0].pixels == paths[0]


def test_arguments_of_pixels_and_checks() -> None:
    request = {"type": "calibrate", "board": None}
    found = task_arguments(request, Path("flat"), None, Path("out"), dark=Path("dark"))
    assert found == ["calibrate", "flat", "--pixels", "flat", "dark", "--out", "out/rig.toml", "--json"]
    found = task_arguments({"type": "check-rig"}, Path("rec"), None, Path("out"), rig=Path("out/calibration-3.toml"))
    assert found == ["check-rig", "rec", "--rig", "out/calibration-3.toml", "--json"]


@pytest.mark.parametrize(
    ("header", "strong", "weak"),
    [
        *(('"a"', True, True), ("*", True, True), ('W/"a"', False, True), ('"b" , "a"', True, True)),
        *(('"b"', False, False), ("a", False, False), ("", False, False), ('"a', False, False)),
    ],
)
def test_entity_tags_are_compared(header: str, strong: bool, weak: bool) -> None:
    assert matches(header, '"a"') == strong
    assert matches(header, '"a"', weak=True) == weak


def test_a_calibration_job_that_waits_can_be_moved_and_cancelled(http: TestClient) -> None:
    key = {"Idempotency-Key": "once"}
    asked = http.post("/v1/rigs/lab3x3/calibrations", json={"ticks": 40}, headers=key)
    assert asked.status_code == 202
    job = asked.json()
    assert http.post("/v1/rigs/lab3x3/calibrations", json={"ticks": 40}, headers=key).json() == job
    assert http.post("/v1/rigs/lab3x3/calibrations", json={"ticks": 41}, headers=key).status_code == 422
    assert len(http.get("/v1/captures").json()["items"]) == 1
    assert http.post("/v1/rigs/lab3x3/calibrations", json={"ticks": 40}).status_code == 409
    assert (job["status"], job["request"]["rig"], job["request"]["apply"]) == ("queued", "lab3x3", True)
    capture = job["request"]["capture"]
    assert http.delete(f"/v1/captures/{capture}").status_code == 409
    location = asked.headers["Location"]
    assert http.put(f"{location}/priority", json={"priority": 7}).json()["priority"] == 7
    assert http.post(f"{location}/cancel").json()["status"] == "cancelled"
    assert http.delete(location).status_code == 204
    assert json.loads(http.get("/v1/jobs").content)["items"] == []
