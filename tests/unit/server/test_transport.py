"""Tests the client against refusals that pass."""

import time
from pathlib import Path

import httpx
import pytest

from server.client import RefusedError, ServiceClient
from server.errors import UploadSizeError
from server.schemas.uploads import Upload

WAITS = {"Retry-After": "2"}


@pytest.fixture
def slept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    waits: list[float] = []
    monkeypatch.setattr(time, "sleep", waits.append)
    return waits


def client_of(answers: list[httpx.Response], sent: list[bytes]) -> ServiceClient:
    def answer(request: httpx.Request) -> httpx.Response:
        sent.append(request.content)
        return answers.pop(0)

    return ServiceClient(httpx.Client(base_url="http://lab.example", transport=httpx.MockTransport(answer)))


def too_many(headers: dict[str, str]) -> httpx.Response:
    return httpx.Response(429, headers=headers, json={"detail": "found too many requests"})


def test_a_request_too_many_is_sent_again_when_it_may_be(slept: list[float]) -> None:
    sent: list[bytes] = []
    upload = Upload(id="u1", created="2026-01-01", name="a", bytes=2, offset=2, sha256=None, state="open")
    client = client_of([too_many(WAITS), too_many(WAITS), httpx.Response(200, content=upload.model_dump_json())], sent)
    assert client.append("u1", b"ab", 0).offset == 2
    assert sent == [b"ab"] * 3
    assert slept == [2, 2]


@pytest.mark.parametrize(
    ("headers", "times"), [(WAITS, 6), ({"Retry-After": "3600"}, 1), ({"Retry-After": "soon"}, 1), ({}, 1)]
)
def test_patience_ends(slept: list[float], headers: dict[str, str], times: int) -> None:
    sent: list[bytes] = []
    client = client_of([too_many(headers) for _ in range(7)], sent)
    with pytest.raises(RefusedError, match="too many requests") as caught:
        client.info()
    assert caught.value.status == 429
    assert (len(sent), len(slept)) == (times, times - 1)


def test_checks_are_those_that_are_told() -> None:
    check = {"ok": False, "found": "no worker", "expected": "one"}
    for answer, names in (
        (httpx.Response(200, json={"worker": check}), ["worker"]),
        (httpx.Response(200, json={}), []),
    ):
        assert list(client_of([answer], []).checks()) == names
    met = httpx.Response(503, json={"detail": "no worker", "checks": {"worker": check}})
    assert list(client_of([met], []).checks()) == ["worker"]
    with pytest.raises(RefusedError, match="not ready"):
        client_of([httpx.Response(503, json={"detail": "not ready", "type": "not-ready"})], []).checks()


@pytest.mark.parametrize("content", [b"Service Unavailable", b"<html>", b"[]", b"{}", b"\xff"])
def test_an_answer_that_is_no_problem_document_is_a_refusal(content: bytes) -> None:
    client = client_of([httpx.Response(503, content=content)], [])
    with pytest.raises(RefusedError, match="found the answer 503 Service Unavailable, expected one of the") as caught:
        client.info()
    assert (caught.value.status, caught.value.exit_code) == (503, 1)


def test_a_file_shorter_than_its_upload_is_refused(tmp_path: Path) -> None:
    upload = Upload(id="u1", created="2026-01-01", name="a", bytes=5, offset=2, sha256=None, state="open")
    (tmp_path / "a.dat").write_bytes(b"ab")
    sent: list[bytes] = []
    client = client_of([httpx.Response(200, content=upload.model_dump_json())], sent)
    with pytest.raises(UploadSizeError, match="to end at byte 2, expected the 5 bytes of u1; give the file"):
        client.send_file(tmp_path / "a.dat", "u1")
    assert len(sent) == 1
