"""Rules that hold for every route: queries, cursors, ranges, methods, keys that come again, ids and the document."""

import re
import zipfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from server.app import create_app
from server.errors import RangeError
from server.ranges import cut, ranges_of
from server.settings import ServiceSettings
from server.store.tables import Entry

DATA = bytes(range(256)) * 4


@pytest.fixture(scope="module")
def http(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    settings = ServiceSettings(data=tmp_path_factory.mktemp("rest"), write_rate=1e6, write_burst=10**6)
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as client:
        yield client


@pytest.fixture(scope="module")
def job(http: TestClient) -> str:
    """A job that is done and has made a file of 1024 bytes."""
    store = http.app.state.services.store  # type: ignore[attr-defined]
    entry = Entry(store.entries.dated_id("j"), "job", "verify", store.entries.now(), {"capture": "c"}, told="done")
    store.entries.add(entry)
    out: Path = store.folder.out(entry.id)
    out.mkdir(parents=True)
    (out / "a.bin").write_bytes(DATA)
    store.artefacts.catalogue(entry.id, out, ["a.bin"])
    return entry.id


def refused(answer: Any, status: int, *words: str) -> None:
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    for word in words:
        assert word in answer.json()["detail"]


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("/v1/jobs?colour=red", "found the query parameter 'colour', expected one of capture, cursor, limit"),
        ("/v1/jobs?limit=1&limit=2", "limit 2 times"),
        ("/v1/info?x=1", "expected none here"),
        ("/metrics?x=1", "expected none here"),
        ("/v1/jobs?cursor=zzz", "query.cursor"),
        ("/v1/jobs?cursor=c20260101-000000-00000000", "query.cursor"),
        ("/v1/captures?cursor=j20260101-000000-00000000", "query.cursor"),
        ("/v1/uploads?cursor=u2026", "query.cursor"),
    ],
)
def test_what_a_query_may_not_say_is_refused(http: TestClient, query: str, said: str) -> None:
    refused(http.get(query), 422, said)


@pytest.mark.parametrize("ticks", ["5:5", "9:3", "0:10:0", "400:0:20"])
def test_planes_that_are_none_are_refused_at_the_border(http: TestClient, ticks: str) -> None:
    answer = http.post("/v1/jobs", json={"type": "images", "capture": "c", "method": "tfi", "ticks": ticks})
    refused(answer, 422, "expected A:B or A:B:STEP with A < B")


BAD = ["bytes=1024-", "bytes=5-2", "bytes=a-b", "lines=0-5", "bytes=", "bytes=-0", "bytes=0-1,9999-", "nonsense"]


@pytest.mark.parametrize("what", ["artefacts/a.bin", "archive"])
@pytest.mark.parametrize("asked", BAD)
@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_a_range_that_is_not_there_is_a_problem(http: TestClient, job: str, what: str, asked: str, method: str) -> None:
    answer = http.request(method, f"/v1/jobs/{job}/{what}", headers={"Range": asked.replace("1024-", "99999-")})
    assert answer.status_code == 416
    assert re.fullmatch(r"bytes \*/\d+", answer.headers["content-range"])
    if method == "GET":
        refused(answer, 416, "found the Range")


def test_an_archive_is_had_in_parts(http: TestClient, job: str) -> None:
    whole = http.get(f"/v1/jobs/{job}/archive")
    assert zipfile.ZipFile(BytesIO(whole.content)).read(f"{job}/a.bin") == DATA
    got = b""
    for first in range(0, len(whole.content), 400):
        part = http.get(f"/v1/jobs/{job}/archive", headers={"Range": f"bytes={first}-{first + 399}"})
        assert part.status_code == 206
        assert len(part.content) == int(part.headers["content-length"])
        got += part.content
    assert got == whole.content
    assert http.get(f"/v1/jobs/{job}/archive", headers={"Range": "bytes=-7"}).content == whole.content[-7:]
    old = {"Range": "bytes=0-3", "If-Range": '"other"'}
    assert http.get(f"/v1/jobs/{job}/archive", headers=old).status_code == 200
    assert http.get(f"/v1/jobs/{job}/archive", headers={"If-None-Match": whole.headers["etag"]}).status_code == 304


@pytest.mark.parametrize("what", ["artefacts/a.bin", "archive"])
def test_a_head_has_the_headers_and_no_body(http: TestClient, job: str, what: str) -> None:
    head, whole = (http.request(method, f"/v1/jobs/{job}/{what}") for method in ("HEAD", "GET"))
    assert (head.status_code, head.content) == (200, b"")
    for name in ("content-length", "etag", "accept-ranges"):
        assert head.headers[name] == whole.headers[name]


@pytest.mark.parametrize(
    ("header", "found"),
    [
        ("bytes=0-0", [(0, 1)]),
        ("bytes=3-", [(3, 10)]),
        ("bytes=-4", [(6, 10)]),
        ("bytes=-99", [(0, 10)]),
        ("Bytes = 2-5 , 7-99", [(2, 6), (7, 10)]),
    ],
)
def test_ranges_of_ten_bytes(header: str, found: list[tuple[int, int]]) -> None:
    assert ranges_of(header, 10) == found


def test_no_byte_of_an_empty_file_may_be_asked_for() -> None:
    for header in ("bytes=0-", "bytes=-1", "bytes=0-0"):
        with pytest.raises(RangeError):
            ranges_of(header, 0)


@pytest.mark.parametrize("size", [1, 3, 10, 100])
def test_a_stream_is_cut_wherever_its_pieces_end(size: int) -> None:
    data = bytes(range(100))
    for first, end in ((0, 100), (0, 1), (99, 100), (10, 11), (7, 93)):
        pieces = (data[at : at + size] for at in range(0, 100, size))
        assert b"".join(cut(pieces, first, end)) == data[first:end]


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PUT", "/v1/jobs/j1", "DELETE, GET, PATCH"),
        ("GET", "/v1/jobs:batch", "POST"),
        ("DELETE", "/v1/jobs", "GET, POST"),
        ("POST", "/v1/uploads/u1", "DELETE, GET, HEAD, PATCH"),
        ("DELETE", "/v1/jobs/j1/archive", "GET, HEAD"),
    ],
)
def test_allow_names_every_method_of_a_path(http: TestClient, method: str, path: str, allowed: str) -> None:
    answer = http.request(method, path)
    refused(answer, 405)
    assert answer.headers["allow"] == allowed


def test_a_change_that_comes_again_under_its_key_changes_nothing(http: TestClient) -> None:
    capture = http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5}).json()["id"]
    stop, key = f"/v1/rigs/lab3x3/captures/{capture}/stop", {"Idempotency-Key": "stop-it"}
    first, again = http.post(stop, headers=key), http.post(stop, headers=key)
    assert (first.status_code, again.status_code) == (200, 200)
    assert first.json() == again.json()
    refused(http.post(stop), 409, "cancelled")
    refused(http.post(f"/v1/captures/{capture}/cancel", headers=key), 422, "another request than before")


def test_a_key_whose_request_was_refused_may_be_used_again(http: TestClient, job: str) -> None:
    for _ in range(2):
        refused(http.post(f"/v1/jobs/{job}/resume", headers={"Idempotency-Key": "too-early"}), 409, "done")


def test_what_is_made_under_a_key_is_made_once(http: TestClient) -> None:
    upload = [http.post("/v1/uploads", json={"name": "a", "bytes": 3}, headers={"Idempotency-Key": "up"}) for _ in "12"]
    assert upload[0].json() == upload[1].json()
    hook = {"url": "https://example.org/hook"}
    made = [http.post("/v1/webhooks", json=hook, headers={"Idempotency-Key": "hook"}) for _ in "12"]
    if made[0].status_code == 201:  # the name may not resolve here
        assert made[0].json() == made[1].json()


def test_every_post_that_changes_something_takes_a_key(http: TestClient) -> None:
    document = http.get("/openapi.json").json()
    lacking = [
        operation["operationId"]
        for item in document["paths"].values()
        for method, operation in item.items()
        if method == "post" and "Idempotency-Key" not in {one["name"] for one in operation.get("parameters", ())}
    ]
    assert lacking == ["test_webhook"]  # it sends a message each time, and changes nothing


def test_operations_have_readable_names_of_their_own(http: TestClient) -> None:
    document = http.get("/openapi.json").json()
    names = [operation["operationId"] for item in document["paths"].values() for operation in item.values()]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)+", name) for name in names), names


def test_events_and_messages_are_in_the_document(http: TestClient) -> None:
    document = http.get("/openapi.json").json()
    message = document["webhooks"]["entry-changed"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    assert message == {"$ref": "#/components/schemas/WebhookMessage"}
    stream = document["paths"]["/v1/events"]["get"]["responses"]["200"]["content"]["text/event-stream"]
    assert stream["schema"] == {"$ref": "#/components/schemas/Event"}
    for name in ("Event", "Progress", "StatusChange", "Happened"):
        assert name in document["components"]["schemas"]


def test_ids_of_one_process_sort_in_their_order(http: TestClient) -> None:
    entries = http.app.state.services.store.entries  # type: ignore[attr-defined]
    ids = [entries.dated_id("j") for _ in range(5000)]
    assert ids == sorted(set(ids))
    assert all(re.fullmatch(r"j\d{8}-\d{6}-[0-9a-f]{8}", one) for one in ids)


def test_a_batch_is_kept_and_queued_in_its_order(http: TestClient) -> None:
    services = http.app.state.services  # type: ignore[attr-defined]
    store = services.store
    capture = Entry(store.entries.dated_id("c"), "capture", "import", store.entries.now(), {}, told="done")
    store.entries.add(capture)
    wanted = [{"capture": capture.id, "seed": seed} for seed in range(300)]
    answer = http.post("/v1/jobs:batch", json={"jobs": wanted}, headers={"Idempotency-Key": "night"})
    jobs = answer.json()["items"]
    assert [job["request"]["seed"] for job in jobs] == list(range(300))
    again = http.post("/v1/jobs:batch", json={"jobs": wanted}, headers={"Idempotency-Key": "night"})
    assert [job["id"] for job in again.json()["items"]] == [job["id"] for job in jobs]
    services.queue.close()  # until all are queued
    known = services.engine._client.list_workflows(queue_name="reconstructions", load_input=False, load_output=False)
    order = [one.workflow_id for one in sorted(known, key=lambda one: one.created_at)]
    assert [one for one in order if one in {job["id"] for job in jobs}] == [job["id"] for job in jobs]
