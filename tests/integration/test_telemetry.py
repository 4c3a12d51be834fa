"""Logs as JSON lines and traces to a collector, from the real processes."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest

from server.client import ServiceClient


class Collector(BaseHTTPRequestHandler):
    received: list[tuple[str, bytes]]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        type(self).received.append((self.path, body))
        self.send_response(200)
        self.end_headers()

    def log_message(self, format: str, *arguments: object) -> None:
        pass


@pytest.fixture
def collector() -> Iterator[tuple[str, list[tuple[str, bytes]]]]:
    Collector.received = []
    server = HTTPServer(("127.0.0.1", 0), Collector)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", Collector.received
    server.shutdown()
    thread.join()
    server.server_close()


def serve(data: Path, *flags: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "server.cli", "serve", "--port", "0", "--data", str(data), *flags],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OTEL_BSP_SCHEDULE_DELAY": "100"},
    )


def test_logs_are_json_lines(tmp_path: Path) -> None:
    service = serve(tmp_path, "--log", "json")
    assert service.stdout is not None
    with ServiceClient.at(service.stdout.readline().strip()) as client:
        client.info()
    service.terminate()
    lines = [json.loads(line) for line in service.communicate(timeout=60)[1].splitlines()]
    (request,) = [line for line in lines if "/v1/info" in line["message"]]
    assert request["name"] == "uvicorn.access"
    assert request["level"] == "INFO"
    assert request["at"]


def test_requests_become_spans(tmp_path: Path, collector: tuple[str, list[tuple[str, bytes]]]) -> None:
    address, received = collector
    service = serve(tmp_path, "--otel", address)
    assert service.stdout is not None
    with ServiceClient.at(service.stdout.readline().strip()) as client:
        client.info()
        for _ in range(600):
            if received:
                break
            threading.Event().wait(0.1)
    service.terminate()
    service.communicate(timeout=60)
    assert {path for path, _ in received} == {"/v1/traces"}
    assert any(b"GET /v1/info" in body for _, body in received)


def test_an_address_that_is_none_is_refused(tmp_path: Path) -> None:
    service = serve(tmp_path, "--otel", "collector:4318")
    assert service.communicate(timeout=60)[1].startswith("spike4dgs: otel: found collector:4318, expected")
    assert service.returncode == 2
