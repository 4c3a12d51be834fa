"""Uploads over REST: every limit and every lie."""

import hashlib
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from server.app import create_app
from server.services.retention import Retention
from server.services.services import Services
from server.settings import ServiceSettings
from server.store import upload_file
from server.store.tables import Entry, StoredUpload
from server.store.upload_file import held
from server.store.uploads import Uploads

DATA = bytes(range(256)) * 20


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    settings = ServiceSettings(data=tmp_path, max_upload_bytes=3_000_000, keep_free_bytes=0)
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as client:
        yield client


def begin(http: TestClient, size: int = len(DATA), **fields: object) -> str:
    response = http.post("/v1/uploads", json={"name": "cam00.dat", "bytes": size} | fields)
    assert response.status_code == 201
    assert response.headers["Location"] == f"/v1/uploads/{response.json()['id']}"
    return response.headers["Location"]


def send(http: TestClient, where: str, data: bytes, offset: int):
    return http.patch(where, content=data, headers={"Upload-Offset": str(offset)})


def refused(response, status: int, *words: str) -> None:
    assert (response.status_code, response.headers["content-type"]) == (status, "application/problem+json")
    for word in words:
        assert word in response.json()["detail"]


def test_pieces_become_a_whole(http: TestClient, tmp_path: Path) -> None:
    where = begin(http, sha256=hashlib.sha256(DATA).hexdigest())
    first = send(http, where, DATA[:1000], 0)
    assert (first.status_code, first.headers["Upload-Offset"], first.json()["offset"]) == (200, "1000", 1000)
    head = http.head(where)
    assert (head.headers["Upload-Offset"], head.headers["Upload-Length"]) == ("1000", str(len(DATA)))
    refused(http.post(f"{where}/commit"), 409, "1000")
    assert send(http, where, DATA[1000:], 1000).json()["state"] == "open"
    whole = http.post(f"{where}/commit").json()
    assert (whole["state"], whole["sha256"]) == ("committed", hashlib.sha256(DATA).hexdigest())
    assert http.post(f"{where}/commit").json() == whole
    assert http.get(where).json() == whole
    assert (tmp_path / "uploads" / whole["id"] / "data").read_bytes() == DATA
    refused(send(http, where, b"x", len(DATA)), 409, "committed")
    assert http.get("/v1/uploads").json() == {"items": [whole], "next": None}


@pytest.mark.parametrize("offset", [1, 999, 1001, 2**63 - 1])
def test_a_piece_at_a_wrong_place_is_told_the_right_one(http: TestClient, offset: int) -> None:
    where = begin(http)
    send(http, where, DATA[:1000], 0)
    answer = send(http, where, DATA[1000:], offset)
    refused(answer, 409, str(offset), "expected 1000")
    assert answer.headers["Upload-Offset"] == "1000"
    assert http.head(where).headers["Upload-Offset"] == "1000"


@pytest.mark.parametrize("offset", [None, "-1", "x", "1e3", str(2**64)])
def test_an_offset_that_is_none_is_refused(http: TestClient, offset: str | None) -> None:
    headers = {} if offset is None else {"Upload-Offset": offset}
    refused(http.patch(begin(http), content=DATA, headers=headers), 422, "Upload-Offset")


@pytest.mark.parametrize("announced", [True, False], ids=["length", "chunked"])
def test_more_bytes_than_announced_leave_what_was_there(http: TestClient, announced: bool) -> None:
    where = begin(http, 2_500_000)
    send(http, where, DATA, 0)
    data = bytes(2_500_000)
    content = data if announced else iter([data[:1_200_000], data[1_200_000:]])
    answer = http.patch(where, content=content, headers={"Upload-Offset": str(len(DATA))})
    refused(answer, 413, "2500000")
    assert http.head(where).headers["Upload-Offset"] == str(len(DATA))


def test_a_wrong_digest_is_never_committed(http: TestClient) -> None:
    where = begin(http, sha256="0" * 64)
    send(http, where, DATA, 0)
    refused(http.post(f"{where}/commit"), 422, hashlib.sha256(DATA).hexdigest(), "0" * 64)
    assert http.get(where).json()["state"] == "open"


@pytest.mark.parametrize(
    "fields",
    [
        {"bytes": 0},
        {"bytes": -1},
        {"bytes": 2**63},
        {"bytes": 1.5},
        {"bytes": "many"},
        {"sha256": "A" * 64},
        {"sha256": "0" * 63},
        {"name": ""},
        {"name": "n" * 81},
        {"name": "a\x00b"},
        {"name": None},
        {"path": "/etc/passwd"},
    ],
    ids=str,
)
def test_a_request_that_does_not_fit_is_refused(http: TestClient, fields: dict[str, object]) -> None:
    refused(http.post("/v1/uploads", json={"name": "a", "bytes": 5} | fields), 422)
    assert http.get("/v1/uploads").json()["items"] == []


def test_an_upload_longer_than_allowed_is_refused(http: TestClient) -> None:
    refused(http.post("/v1/uploads", json={"name": "a", "bytes": 3_000_001}), 413, "3000000")


@pytest.mark.parametrize("name", ["../../../etc/passwd", "/etc/passwd", "..", "C:\\x", "名前 🎥.dat", "a'; rm -rf /"])
def test_a_name_is_a_label_and_no_path(http: TestClient, tmp_path: Path, name: str) -> None:
    where = begin(http, name=name)
    upload_id = where.rpartition("/")[2]
    assert http.get(where).json()["name"] == name
    assert [path.name for path in (tmp_path / "uploads").iterdir()] == [upload_id]
    assert [path.name for path in (tmp_path / "uploads" / upload_id).iterdir()] == ["data"]


@pytest.mark.parametrize("upload_id", ["u20240101-000000-00000000", "..%2f..", "x" * 500, "c20240101-000000-00000000"])
def test_an_unknown_upload_is_not_found(http: TestClient, upload_id: str) -> None:
    where = f"/v1/uploads/{upload_id}"
    for response in (http.get(where), send(http, where, b"x", 0), http.post(f"{where}/commit"), http.delete(where)):
        refused(response, 404)
    assert http.head(where).status_code == 404


def test_one_request_at_a_time_writes(http: TestClient, tmp_path: Path) -> None:
    where = begin(http)
    with held(tmp_path / "uploads" / where.rpartition("/")[2] / "data"):
        for response in (send(http, where, DATA, 0), http.delete(where)):
            refused(response, 409, "one at a time")
    assert send(http, where, DATA, 0).status_code == 200


def test_a_full_disk_keeps_what_came_and_the_upload_goes_on(http: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    where, real = begin(http), os.pwrite

    def short(descriptor: int, data: memoryview, offset: int) -> int:
        if offset >= 700:
            raise OSError(28, "No space left on device")
        return real(descriptor, data[: 700 - offset], offset)

    monkeypatch.setattr(upload_file.os, "pwrite", short)
    answer = send(http, where, DATA, 0)
    refused(answer, 507, "No space left on device")
    assert answer.headers["Upload-Offset"] == "700"
    monkeypatch.undo()
    send(http, where, DATA[700:], 700)
    assert http.post(f"{where}/commit").json()["sha256"] == hashlib.sha256(DATA).hexdigest()


def test_bytes_that_cannot_be_flushed_do_not_count(http: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    where = begin(http)
    send(http, where, DATA[:1000], 0)

    def refuse(descriptor: int) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(upload_file.os, "fsync", refuse)
    refused(send(http, where, DATA[1000:], 1000), 507, "Input/output error")
    monkeypatch.undo()
    assert http.head(where).headers["Upload-Offset"] == "1000"


def test_some_of_the_disk_is_left_free(tmp_path: Path) -> None:
    settings = ServiceSettings(data=tmp_path, keep_free_bytes=2**62)
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as http:
        refused(http.post("/v1/uploads", json={"name": "a", "bytes": 5}), 507, "found 0 bytes free")


def test_a_stale_upload_is_deleted_with_its_bytes(http: TestClient, tmp_path: Path) -> None:
    where = begin(http)
    send(http, where, DATA[:1000], 0)
    assert http.delete(where).status_code == 204
    assert list((tmp_path / "uploads").iterdir()) == []
    refused(http.get(where), 404)


def test_an_upload_whose_bytes_are_gone_can_be_deleted(http: TestClient, tmp_path: Path) -> None:
    """A database that is put back from a backup names uploads which were deleted since."""
    where = begin(http)
    shutil.rmtree(tmp_path / "uploads" / where.rpartition("/")[2])
    for answer in (send(http, where, DATA, 0), http.post(f"{where}/commit")):
        refused(answer, 404, "found no bytes of the upload", "delete it")
    assert http.delete(where).status_code == 204
    assert http.get("/v1/uploads").json()["items"] == []


def test_what_cannot_be_deleted_keeps_nothing_else(
    http: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    services: Services = http.app.state.services  # type: ignore[attr-defined]
    stuck, *_ = [begin(http).rpartition("/")[2] for _ in range(4)]
    delete = services.uploads.delete

    def refuse(upload_id: str) -> None:
        if upload_id == stuck:
            raise PermissionError(13, "Permission denied")
        delete(upload_id)

    monkeypatch.setattr(services.uploads, "delete", refuse)
    monkeypatch.setattr(services.store, "clock", lambda: time.time() + 8 * 24 * 3600)
    Retention(services.store, services.engine, services.jobs, services.uploads, None, 7.0).tidy()
    assert [one["id"] for one in http.get("/v1/uploads").json()["items"]] == [stuck]
    assert f"{stuck} is not deleted: [Errno 13] Permission denied" in caplog.text


def test_cameras_to_render_from_are_no_recording(http: TestClient) -> None:
    """They are read whole, by the process that serves everybody."""
    services: Services = http.app.state.services  # type: ignore[attr-defined]
    entries, uploads = services.store.entries, services.store.uploads
    job = Entry(entries.dated_id("j"), "job", "reconstruct", entries.now(), {"capture": "c"})
    entries.add(job)
    upload = StoredUpload(entries.dated_id("u"), entries.now(), "cam00.dat", 2**24 + 1, None, "committed")
    uploads.insert(upload)
    answer = http.post("/v1/jobs", json={"type": "render", "job": job.id, "cameras": upload.id})
    refused(answer, 422, "found 16777217 bytes of cameras, expected a transforms.json of at most 16777216")


def test_uploads_come_in_pages(http: TestClient) -> None:
    made = {begin(http).rpartition("/")[2] for _ in range(5)}
    first = http.get("/v1/uploads?limit=3").json()
    rest = http.get(f"/v1/uploads?limit=3&cursor={first['next']}").json()
    assert {item["id"] for item in first["items"] + rest["items"]} == made
    assert rest["next"] is None


def test_a_request_that_failed_halfway_can_be_sent_again(http: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    request = {"json": {"name": "a.dat", "bytes": 10}, "headers": {"Idempotency-Key": "one"}}
    with monkeypatch.context() as broken:
        broken.setattr(Uploads, "insert", refuse_insert)
        refused(http.post("/v1/uploads", **request), 503, "the database does not answer")
    made = http.post("/v1/uploads", **request)
    assert made.status_code == 201
    assert http.post("/v1/uploads", **request).json() == made.json()


def refuse_insert(*_: object) -> None:
    raise sa.exc.OperationalError("INSERT", {}, OSError("no answer"))
