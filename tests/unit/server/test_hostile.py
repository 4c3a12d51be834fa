"""Tests that hostile or broken requests are refused in order: never a 5xx, never a way out of the data folder."""

import asyncio
import json
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from sqlalchemy.exc import DataError

from server.app import create_app
from server.errors import SlowBodyError
from server.middleware.limits import BodyLimit
from server.settings import ServiceSettings
from server.store.webhooks import Webhooks

JSON = {"Content-Type": "application/json"}
ID = "20260101-000000-00000000"
CLIMBS = ("..%2f..%2fetc%2fpasswd", "%2e%2e/%2e%2e", "..%5c..%5cx", "%00", "x%00.json")
CLIMBS += (
    "%252e%252e%252f",
    "..;%2f..",
    "%c0%ae%c0%ae/",
    "%ed%a0%80",
    "%e2%80%ae",
    "A" * 5000,
    "/etc/passwd",
    "~",
    "C:%5c",
)


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    settings = ServiceSettings(data=tmp_path_factory.mktemp("hostile"), read_burst=10**6, write_burst=10**6)
    with TestClient(create_app(settings), base_url="http://127.0.0.1", raise_server_exceptions=False) as client:
        yield client


def assert_refused(answer, *statuses: int) -> None:
    assert answer.status_code in statuses, (answer.status_code, answer.text[:300])
    if answer.request.method != "HEAD":
        assert answer.headers["content-type"] == "application/problem+json"
        document = json.loads(answer.content)
        assert document["status"] == answer.status_code
        assert len(answer.content) < 20_000
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("climb", CLIMBS)
def test_no_name_leaves_the_data_folder(http, climb: str) -> None:
    for path in (
        *(f"/v1/rigs/{climb}", f"/v1/captures/{climb}", f"/v1/jobs/{climb}", f"/v1/jobs/{climb}/log"),
        *(f"/v1/jobs/{climb}/artefacts/run.json", f"/v1/jobs/j{ID}/artefacts/{climb}", f"/v1/{climb}"),
    ):
        assert_refused(http.get(path), 404, 405, 422)
    for query in ("cursor", "name", "rig", "capture", "type", "status"):
        assert http.get(f"/v1/jobs?{query}={climb}").status_code in (200, 422)
    for body in ({"capture": climb}, {"type": "evaluate", "job": climb}, {"type": "verify", "capture": climb}):
        assert_refused(http.post("/v1/jobs", json=body), 422)


def test_a_webhook_that_no_database_may_be_asked_for_is_not_found(http, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:  # as PostgreSQL's driver does
        raise DataError("SELECT", {}, ValueError("PostgreSQL text fields cannot contain NUL (0x00) bytes"))

    monkeypatch.setattr(Webhooks, "select", refuse)
    for path in ("%00", "%00/deliveries", "w00112233445566%00"):
        assert_refused(http.get(f"/v1/webhooks/{path}"), 404)
    assert_refused(http.delete("/v1/webhooks/%00"), 404)


@pytest.mark.parametrize(
    "value",
    [None, True, "", "5", 1.5, -1, 10**30, [], {}, [5], "NaN", "\x00", "\u202e", "😀" * 50, "x" * 10_000],
    ids=lambda value: repr(value)[:12],
)
@pytest.mark.parametrize("member", ["ticks", "until_stopped", "pre_trigger_ms", "threshold", "name", "rejoin_s", "x"])
def test_wrong_types_are_refused(http, member: str, value: object) -> None:
    fits = {"name", "ticks"}  # a number in a string is read as one
    body = {"ticks": -1} | {member: value} if member in fits and value == "5" else {"ticks": 5, member: value}
    answer = http.post("/v1/rigs/nothing/captures", json=body)
    if answer.status_code == 404:  # it fits, and the rig does not
        assert value is None or member in ("name", "pre_trigger_ms", "rejoin_s", "until_stopped", "ticks")
    else:
        assert_refused(answer, 422)


@pytest.mark.parametrize(
    "name", ["a\u202eb", "\u2066x\u2069", "a\u2028b", "a\x85b", "a\x7f", "\ufeff", "a\tb", "a\n", "", "n" * 81]
)
def test_names_that_would_mislead_are_refused(http, name: str) -> None:
    assert_refused(http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5, "name": name}), 422)


@pytest.mark.parametrize("name", ["עברית", "عربي", "日本", "é", "👩‍🔬 fan", "<script>", "'; DROP TABLE entries--"])
def test_names_in_any_script_are_kept(http, name: str) -> None:
    answer = http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5, "name": name})
    assert answer.status_code == 202
    assert answer.json()["name"] == name
    assert [item["name"] for item in http.get("/v1/captures", params={"name": name}).json()["items"]] == [name]
    http.post(f"/v1/rigs/lab3x3/captures/{answer.json()['id']}/stop")


@pytest.mark.parametrize(
    ("body", "status", "word"),
    [
        (b'{"capture": "c", "budget_s": NaN}', 400, "found NaN"),
        (b'{"capture": "c", "budget_s": Infinity}', 400, "found Infinity"),
        (b'{"capture": "c", "budget_s": -Infinity}', 400, "found -Infinity"),
        (b'{"capture": "c", "budget_s": 1e999}', 422, "budget_s"),
        (b'{"capture": "c", "steps": 1' + b"0" * 5000 + b"}", 422, ""),
        (b'{"capture": "c", "steps": 1' + b"0" * 400 + b"}", 422, "steps"),
        (b'{"capture": "c", "steps": 5, "steps": 6}', 400, "'steps' twice"),
        (b'{"capture": "c", "name": "\\ud800"}', 422, "name"),
        (b'{"capture": "c", "\\ud800": 1}', 422, ""),
        (b'{"capture": "c", "name": "\\u0000"}', 422, "name"),
        (b'{"capture": "\xff"}', 400, ""),
        (b"[" * 100_000, 400, "deeper"),
        (b"[" * 500 + b"]" * 500, 400, "deeper"),
        (b'{"a":' * 40 + b"1" + b"}" * 40, 400, "deeper"),
        (b"[" * 20 + b"]" * 20, 422, ""),
        (b"", 422, ""),
        (b"null", 422, ""),
        (b"{", 422, ""),
        (b'\xef\xbb\xbf{"capture": "c"}', 422, ""),
        (json.dumps({f"m{n}": n for n in range(50_000)}).encode(), 422, ""),
        (json.dumps({"type": "m" * 900_000}).encode(), 422, ""),
    ],
    ids=lambda value: repr(value)[:24],
)
def test_bodies_that_readers_differ_about_are_refused(http, body: bytes, status: int, word: str) -> None:
    for path in ("/v1/jobs", "/v1/jobs:batch"):
        answer = http.post(path, content=body, headers=JSON)
        if path == "/v1/jobs" or status == 400:
            assert_refused(answer, *((400, 422) if b"0" * 5000 in body else (status,)))
            assert word in answer.json()["detail"]
        else:
            assert_refused(answer, 400, 422)


@pytest.mark.parametrize(
    "media_type", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", "", "x"]
)
def test_another_content_type_is_refused(http, media_type: str) -> None:
    body = b'{"ticks": 5}'
    assert_refused(http.post("/v1/rigs/lab3x3/captures", content=body, headers={"Content-Type": media_type}), 422)


def test_a_body_too_long_is_refused_before_it_is_read(http) -> None:
    headers = JSON | {"Content-Length": str(2**20 + 1)}

    def unread():
        raise AssertionError("the body was read")
        yield b""

    async def meet(scope_headers, receive):
        sent = []

        async def send(message):
            sent.append(message)

        scope = {"type": "http", "method": "POST", "path": "/v1/jobs", "headers": scope_headers}
        await BodyLimit(None, ServiceSettings())(scope, receive, send)  # type: ignore[arg-type]
        return sent[0]["status"]

    async def refuse():
        raise AssertionError("the body was read")

    lengths = [str(2**20 + 1), "9" * 5000]
    for length in lengths:
        assert asyncio.run(meet([(b"content-length", length.encode())], refuse)) == 413
    assert_refused(http.post("/v1/jobs", content=b"x" * (2**20 + 1), headers=headers), 413)
    pieces = (b" " * 2**16 for _ in range(17))  # no length is said
    assert_refused(http.post("/v1/jobs", content=pieces, headers=JSON), 413)
    assert http.post("/v1/jobs", content=b" " * 2**20, headers=JSON).status_code == 422


def test_a_body_that_does_not_come_is_given_up() -> None:
    sent: list[dict] = []

    async def never():
        await asyncio.sleep(3600)

    async def send(message):
        sent.append(message)

    async def read(scope, receive, send):
        await receive()

    limit = BodyLimit(read, ServiceSettings(body_s=0.01))
    scope = {"type": "http", "method": "POST", "path": "/v1/jobs", "headers": []}
    asyncio.run(limit(scope, never, send))
    assert sent[0]["status"] == 408
    with pytest.raises(SlowBodyError):
        asyncio.run(limit(scope | {"method": "PATCH", "path": "/v1/uploads/u"}, never, send))


def test_the_parts_of_an_upload_are_streamed() -> None:
    seen = []

    async def read(scope, receive, send):
        more = True
        while more:
            message = await receive()
            seen.append(len(message["body"]))
            more = message["more_body"]

    pieces = [{"type": "http.request", "body": b"x" * 2**20, "more_body": n > 0} for n in range(4)]

    async def receive():
        return pieces.pop()

    async def send(message):
        raise AssertionError(message)

    scope = {"type": "http", "method": "PATCH", "path": "/v1/uploads/u", "headers": [(b"content-length", b"4194304")]}
    asyncio.run(BodyLimit(read, ServiceSettings())(scope, receive, send))
    assert seen == [2**20] * 4


@pytest.mark.parametrize("method", ["OPTIONS", "TRACE", "CONNECT", "PROPFIND", "GETX", "PUT", "PATCH"])
def test_another_method_is_refused(http, method: str) -> None:
    for path in ("/v1/info", "/v1/jobs", "/v1/rigs/lab3x3/captures"):
        answer = http.request(method, path)
        assert_refused(answer, 405)
        assert answer.headers["allow"]
        assert "access-control-allow-origin" not in answer.headers


def test_no_header_changes_the_method(http) -> None:
    override = {"X-HTTP-Method-Override": "DELETE", "X-Method-Override": "DELETE", "X-HTTP-Method": "DELETE"}
    assert http.get("/v1/jobs", headers=override).status_code == 200
    assert_refused(http.get("/v1/jobs?_method=DELETE"), 422)
    assert_refused(http.post("/v1/jobs", headers=override), 422)


@pytest.mark.parametrize(
    "query",
    [
        *("limit=0", "limit=NaN", "limit=1e3", "limit=" + "9" * 5000, "limit=-1", "status=gone", "cursor=" + "c" * 41),
        *("limit=1;drop", "limit=%00", "name=%00", "rig=" + "r" * 1000, "type=%0a"),
    ],
)
def test_queries_that_do_not_fit_are_refused(http, query: str) -> None:
    for path in ("/v1/jobs", "/v1/captures"):
        if not (path == "/v1/captures" and query.startswith("type")):
            assert_refused(http.get(f"{path}?{query}"), 422)


@pytest.mark.parametrize("key", ["", "k" * 201, "k\xff", "a b\t"])
def test_keys_that_do_not_fit_are_refused(http, key: str) -> None:
    headers = {"Idempotency-Key": key.encode("latin-1")}
    assert_refused(http.post("/v1/rigs/lab3x3/captures", json={"ticks": 5}, headers=headers), 422)


def test_every_answer_has_the_headers(http) -> None:
    for path in ("/", "/page.js", "/openapi.json", "/v1/info", "/v1/nothing", "/nothing"):
        answer = http.get(path)
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"
        assert answer.headers["x-frame-options"] in ("DENY", "SAMEORIGIN")
        assert "frame-ancestors" in answer.headers["content-security-policy"]
    assert "default-src 'self'" in http.get("/").headers["content-security-policy"]
    assert http.get("/", headers={"Host": "evil.example"}).headers["x-content-type-options"] == "nosniff"


def test_an_error_nobody_expected_has_them_too(tmp_path: Path, monkeypatch) -> None:
    app = create_app(ServiceSettings(data=tmp_path))
    with TestClient(app, base_url="http://127.0.0.1", raise_server_exceptions=False) as http:
        monkeypatch.setattr(app.state.services.jobs, "get", lambda _: 1 // 0)
        assert_refused(http.get(f"/v1/jobs/j{ID}"), 500)
