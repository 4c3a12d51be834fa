"""Tests that what begins fits the disk beside what has begun, and that a full disk can be emptied."""

import shutil
import threading
from collections import namedtuple

import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient

from acquisition.errors import DiskError
from acquisition.recording.direct import DirectFile
from rigs.toml import catalog_rig, dump_rig
from server.app import create_app
from server.cli.main import cli
from server.settings import ServiceSettings
from server.store.disk import Disk

RIG = catalog_rig("lab3x3")
TICK_BYTES = sum(camera.width * camera.height // 8 for camera in RIG.cameras)
KEEP_FREE = 5_000
Usage = namedtuple("Usage", "total used free")


@pytest.fixture
def free(monkeypatch):
    """Let the disk seem to have this many free bytes, a dictionary's `bytes`."""
    seeming = {"bytes": 10**9}
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**9, 0, seeming["bytes"]))
    return seeming


@pytest.fixture
def http(tmp_path, free):
    settings = ServiceSettings(data=tmp_path, keep_free_bytes=KEEP_FREE)
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as client:
        yield client


def begin(http, size: int) -> int:
    return http.post("/v1/uploads", json={"name": "a", "bytes": size}).status_code


def test_two_uploads_that_do_not_fit_together_are_not_both_accepted(http, free) -> None:
    free["bytes"] = KEEP_FREE + 1000
    assert begin(http, 600) == 201
    refused = http.post("/v1/uploads", json={"name": "b", "bytes": 401})
    assert (refused.status_code, refused.json()["detail"]) == (
        507,
        "found 400 bytes free, expected the 401 that are asked for; delete something",
    )
    assert begin(http, 400) == 201


def test_of_many_uploads_at_once_those_begin_that_fit(http, free) -> None:
    free["bytes"] = KEEP_FREE + 1000
    answers: list[int] = []
    threads = [threading.Thread(target=lambda: answers.append(begin(http, 300))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [201] * 3 + [507] * 5


def test_what_an_upload_has_received_is_counted_once(http, free) -> None:
    free["bytes"] = KEEP_FREE + 1000
    upload = http.post("/v1/uploads", json={"name": "a", "bytes": 600}).json()["id"]
    http.patch(f"/v1/uploads/{upload}", content=bytes(500), headers={"Upload-Offset": "0"})
    free["bytes"] -= 500
    assert begin(http, 401) == 507
    assert begin(http, 400) == 201


def test_a_capture_that_cannot_fit_is_refused_before_it_begins(http, free) -> None:
    free["bytes"] = KEEP_FREE + 100 * TICK_BYTES
    assert http.post("/v1/rigs/lab3x3/captures", json={"ticks": 101}).status_code == 507
    assert http.get("/v1/captures").json()["items"] == []
    assert http.post("/v1/rigs/lab3x3/captures", json={"until_stopped": True}).status_code == 507
    assert http.post("/v1/rigs/lab3x3/captures", json={"ticks": 60}).status_code == 202
    assert begin(http, 40 * TICK_BYTES + 1) == 507
    assert begin(http, 40 * TICK_BYTES) == 201


def test_a_busy_rig_is_told_before_the_disk(http, free) -> None:
    free["bytes"] = KEEP_FREE + 100 * TICK_BYTES
    assert http.post("/v1/rigs/lab3x3/captures", json={"ticks": 60}).status_code == 202
    assert http.post("/v1/rigs/lab3x3/captures", json={"ticks": 60}).status_code == 409


def test_the_reserve_is_given_up_for_what_makes_room_and_taken_again(tmp_path, free) -> None:
    disk = Disk(tmp_path, 0)
    disk.keep_reserve()
    reserve = tmp_path / "reserve"
    assert reserve.stat().st_blocks * 512 >= 16 << 20
    with disk.making_room():
        assert reserve.exists()
    free["bytes"] = 0
    with disk.making_room():
        assert not reserve.exists()
    assert reserve.exists()


def test_the_reserve_is_taken_again_after_the_last_of_those_that_make_room(tmp_path, free) -> None:
    disk = Disk(tmp_path, 0)
    disk.keep_reserve()
    free["bytes"] = 0
    with disk.making_room():
        with disk.making_room():
            pass
        assert not (tmp_path / "reserve").exists()
    assert (tmp_path / "reserve").exists()


def test_a_disk_without_room_for_the_reserve_goes_without(tmp_path, monkeypatch) -> None:
    def refuse(*args: object) -> None:
        raise OSError(28, "No space left on device")

    disk = Disk(tmp_path, 0)
    monkeypatch.setattr("os.posix_fallocate", refuse)
    disk.keep_reserve()
    assert list(tmp_path.iterdir()) == []


def test_an_import_is_promised_the_room_of_its_uploads(http, free, tmp_path) -> None:
    dats = []
    for _ in RIG.ids:
        dats.append(http.post("/v1/uploads", json={"name": "a", "bytes": 100}).json()["id"])
        http.patch(f"/v1/uploads/{dats[-1]}", content=bytes(100), headers={"Upload-Offset": "0"})
        assert http.post(f"/v1/uploads/{dats[-1]}/commit").status_code == 200
    body = {"uploads": dats, "cameras": {"rig": "lab3x3"}, "tick_rate_hz": 20000}
    free["bytes"] = KEEP_FREE + 899
    before = list((tmp_path / "entries").iterdir())
    refused = http.post("/v1/captures:import", json=body)
    assert (refused.status_code, refused.json()["detail"]) == (
        507,
        "found 899 bytes free, expected the 900 that are asked for; delete something",
    )
    assert list((tmp_path / "entries").iterdir()) == before
    free["bytes"] = KEEP_FREE + 1000
    imported = http.post("/v1/captures:import", json=body)
    assert imported.status_code == 202
    assert begin(http, 101) == 507  # it copies the uploads yet
    (tmp_path / "captures" / imported.json()["id"]).mkdir()  # it is whole
    assert begin(http, 101) == 201


def test_what_a_recorder_has_reserved_is_counted_once(http, free, tmp_path) -> None:
    free["bytes"] = KEEP_FREE + 100 * TICK_BYTES
    capture = http.post("/v1/rigs/lab3x3/captures", json={"ticks": 60}).json()["id"]
    written = tmp_path / "captures" / f"{capture}.partial"
    written.mkdir()
    file = DirectFile(written / "cam00.dat")
    file.reserve(60 * TICK_BYTES)
    file.abandon()
    if 512 * (written / "cam00.dat").stat().st_blocks < 60 * TICK_BYTES:
        pytest.skip("needs a file system that reserves room for a file")
    free["bytes"] -= 60 * TICK_BYTES
    assert begin(http, 40 * TICK_BYTES) == 201


def test_a_disk_that_does_not_answer_leaves_the_reserve_to_the_next(tmp_path, free, monkeypatch) -> None:
    disk = Disk(tmp_path, 0)
    disk.keep_reserve()
    with monkeypatch.context() as gone:
        gone.setattr(shutil, "disk_usage", raise_error)
        with pytest.raises(OSError, match="gone"), disk.making_room():
            pass
    free["bytes"] = 0
    with disk.making_room():
        assert not (tmp_path / "reserve").exists()
    assert (tmp_path / "reserve").exists()


def raise_error(*_: object) -> None:
    raise OSError(5, "gone")


def test_an_import_leaves_free_what_it_is_told_to(tmp_path, free) -> None:
    rig = RIG.scaled(40, 24).only(["cam00"])
    (tmp_path / "cam00.dat").write_bytes(bytes(10 * 120))
    (tmp_path / "rig.toml").write_text(dump_rig(rig))
    dats = ["--dat", str(tmp_path / "cam00.dat"), "--cameras", str(tmp_path / "rig.toml"), "--tick-rate", "20000"]
    free["bytes"] = 30_000_000
    arguments = ["import", *dats, "--out", str(tmp_path / "rec")]
    refused = CliRunner().invoke(cli, [*arguments, "--keep-free", "30"]).exception
    assert isinstance(refused, DiskError)
    assert "found 30000000 bytes free" in str(refused)
    assert CliRunner().invoke(cli, arguments, catch_exceptions=False).exit_code == 0
