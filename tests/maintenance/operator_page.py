"""The operator's page in a real browser, before a real service whose stages are played by fake_stage.py.

A test file that drives the page takes its fixtures from `tests/integration/conftest.py`, which has them from here, and
is marked with `pytestmark = BROWSER`. The service, its capture and its job are made once a file.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from maintenance.waiting import wait_for

from server.client import ServiceClient
from server.schemas.captures import Capture, CaptureRequest
from server.schemas.job_types import ReconstructRequest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BROWSER = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("playwright") is None, reason="found no playwright; install it with the dev extra"),
    pytest.mark.skipif(CHROMIUM is None, reason="found no chromium on the path; install it"),
]
FAKE = (sys.executable, str(Path(__file__).parents[1] / "integration" / "fake_stage.py"))
EVIL = "<img src=x onerror=alert(1)> & <b>bold</b>"
LONG_MS = 60_000


@dataclass
class Service:
    """A service with its worker; `client` talks to it beside the browser."""

    address: str
    data: Path
    client: ServiceClient

    def wait(self, job_id: str, status: str) -> None:
        wait_for(lambda: self.client.job(job_id).status == status)


@dataclass
class Seen:
    """Holds the lines of a page's console and the hosts it asked."""

    faults: list[str] = field(default_factory=list)
    hosts: set[str] = field(default_factory=set)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    data = tmp_path_factory.mktemp("page") / "data"
    fake = {"SPIKE4DGS_STAGE_COMMAND": json.dumps(FAKE), "FAKE_STEPS": "250", "FAKE_RESULTS": "yes"}
    command = [sys.executable, "-m", "server.cli", "serve", "--port", "0", "--data", str(data), "--with-worker"]
    with subprocess.Popen(command, env=os.environ | fake, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        with ServiceClient.at(address) as client:
            wait_for(lambda: client.checks()["worker"].ok)
            yield Service(address, data, client)
        process.terminate()


@pytest.fixture(scope="module")
def capture(service: Service) -> Capture:
    """A finished capture whose name looks like HTML."""
    made = service.client.start_capture("lab3x3", CaptureRequest(ticks=40, name=EVIL))
    wait_for(lambda: service.client.capture(made.id).status == "done")
    return service.client.capture(made.id)


@pytest.fixture(scope="module")
def done(service: Service, capture: Capture) -> str:
    """A finished reconstruction."""
    job = service.client.submit(ReconstructRequest(capture=capture.id, holdout="cam11"))
    service.wait(job.id, "done")
    return job.id


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as runner:
        browser = runner.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def seen() -> Seen:
    return Seen()


@pytest.fixture
def open_page(service: Service, chromium: Any, seen: Seen) -> Iterator[Callable[..., Any]]:
    """Opens the page in a window of its own; its faults go to `seen`."""
    contexts = []

    def opened(width: int = 1280, scheme: str = "light", prepare: Callable[[Any], None] | None = None) -> Any:
        context = chromium.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        context.set_default_timeout(LONG_MS)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda said: seen.faults.append(said.text) if said.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: seen.faults.append(str(error)))
        page.on("request", lambda request: seen.hosts.add("/".join(request.url.split("/")[:3])))
        if prepare:
            prepare(page)
        page.goto(service.address)
        return page

    yield opened
    for context in contexts:
        context.close()


def expect(locator: Any) -> Any:
    """Expect something of a part of the page within a minute."""
    from playwright import sync_api

    sync_api.expect.set_options(timeout=LONG_MS)
    return sync_api.expect(locator)


def newest(service: Service) -> str:
    return service.client.jobs(limit=1)[0].id


def drawn(page: Any, selector: str) -> None:
    """Wait for a picture, and for its pixels."""
    page.locator(selector).scroll_into_view_if_needed()
    page.wait_for_function("(s) => document.querySelector(s)?.naturalWidth > 100", arg=selector)


# Texts whose contrast with what is behind them is below 4.5 (WCAG 2.2, 1.4.3), and those contrasts.
CONTRAST = """() => {
  const parts = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = (text) => {
    const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    const [r, g, b] = parts(text).map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (one) => {
    for (; one; one = one.parentElement) {
      const found = getComputedStyle(one).backgroundColor;
      if ((parts(found)[3] ?? 1) === 1) return found;
    }
    return 'rgb(255, 255, 255)';
  };
  const found = [];
  for (const one of document.querySelectorAll('p, h1, h2, h3, li, button, a, summary, label, figcaption, span, pre')) {
    if (!one.textContent.trim() || one.disabled || !one.checkVisibility()) continue;
    const [a, b] = [light(getComputedStyle(one).color), light(behind(one))];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < 4.5) found.push([one.outerHTML.slice(0, 80), contrast]);
  }
  return found;
}"""
