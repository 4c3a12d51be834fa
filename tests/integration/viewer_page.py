"""Serves the viewer's page beside made-up jobs, opens it in a real browser, and reads what it draws."""

import base64
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import uvicorn
from fastapi import FastAPI, Response
from fastapi.responses import FileResponse
from integration.fake_scene import CAMERAS, TALL, WIDE
from numpy.typing import NDArray

from server.errors import NotFoundError
from server.middleware import problems
from server.middleware.guard import LoopbackGuard
from server.routes import page

playwright = pytest.importorskip("playwright.sync_api", reason="found no playwright; install it with the dev extra")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
RENDERER = Path(page.__file__).parents[1] / "page/viewer/vendor/spark.js"
VIEWER = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="found no chromium on the path; install it"),
    pytest.mark.skipif(not RENDERER.exists(), reason="found no renderer of the viewer; run `make viewer`"),
]
ARGUMENTS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
PLANES, TICK_RATE_HZ = 400, 20_000.0
NAME = "fan & ball, <i>second</i> try"

# A canvas forgets what it shows once it is shown; here it keeps it, to be read.
KEEP_DRAWN = """
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return getContext.call(this, kind, { ...options, preserveDrawingBuffer: true });
};
"""


def grey_of(plane: int) -> int:
    """The grey of the made-up picture at a plane."""
    return 60 + plane // 4


def app_of(jobs: Path) -> FastAPI:
    """The page's own routes, guard and headers, with artefacts from a folder and pictures of one grey each."""
    app = FastAPI()
    app.include_router(page.router)
    problems.install(app)
    app.add_middleware(LoopbackGuard)

    @app.get("/v1/jobs/{job}/artefacts/{name}")
    def artefact(job: str, name: str) -> FileResponse:
        if not (jobs / job / name).is_file():
            raise NotFoundError(f"found no artefact {name} of {job}, expected one")
        return FileResponse(jobs / job / name)

    @app.get("/v1/jobs/{job}")
    def described(job: str) -> dict[str, Any]:
        return {"id": job, "type": "reconstruct", "name": NAME, "request": {"capture": "c1"}}

    @app.get("/v1/jobs/{job}/pictures")
    def pictures(job: str) -> dict[str, Any]:
        if job == "keyframes":
            raise NotFoundError("found no capture c1", "one that GET /v1/captures lists")
        cameras = [camera["id"] for camera in CAMERAS]
        return {"method": "adaptive", "cameras": cameras, "planes": PLANES, "tick_rate_hz": TICK_RATE_HZ, "white": 0.4}

    @app.get("/v1/jobs/{job}/pictures/{camera}")
    def picture(job: str, camera: str, plane: int) -> Response:
        _done, data = cv2.imencode(".png", np.full((TALL, WIDE), grey_of(plane), np.uint8))
        return Response(data.tobytes(), media_type="image/png")

    return app


@contextmanager
def served(app: FastAPI) -> Iterator[str]:
    """Serve an application; gives the address."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        config = uvicorn.Config(app, log_level="error", ws="none", timeout_graceful_shutdown=1)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        server.should_exit = True
        thread.join()


@contextmanager
def chromium() -> Iterator[Any]:
    """Run a browser."""
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield running
        running.close()


@contextmanager
def opening(browser: Any, address: str) -> Iterator[Callable[..., Any]]:
    """Opens /viewer.html; in the end nothing was asked of another host and nothing was complained of."""
    pages, asked, faults = [], [], []

    def open_at(query: str = "?job=polynomial", *, width: int = 900, height: int = 700, script: str = "") -> Any:
        made = browser.new_page(viewport={"width": width, "height": height})
        pages.append(made)
        made.set_default_timeout(30_000)
        made.add_init_script(KEEP_DRAWN + script)
        made.on("request", lambda request: asked.append(request.url))
        made.on(
            "console", lambda message: faults.append(message.text) if message.type in ("error", "warning") else None
        )
        made.on("pageerror", lambda error: faults.append(str(error)))
        made.context.grant_permissions(["clipboard-read", "clipboard-write"])
        made.goto(f"{address}/viewer.html{query}")
        return made

    open_at.faults = faults
    yield open_at
    for made in pages:
        made.close()
    assert [url for url in asked if not url.startswith((f"{address}/", "data:", f"blob:{address}/"))] == []
    assert faults == []


def settle(view: Any) -> None:
    view.wait_for_selector("#picture[data-settled=yes]")


def until(view: Any, condition: str) -> None:
    """Wait for a condition; the page's policy forbids Playwright's own way, which evaluates text in it."""
    for _ in range(1500):
        if view.evaluate(condition):
            return
        view.wait_for_timeout(20)
    raise AssertionError(f"waited in vain for {condition}")


def put(view: Any, u: float) -> None:
    """Move the slider of time."""
    view.eval_on_selector("#time", "(range, u) => { range.value = u; range.dispatchEvent(new Event('input')); }", u)


def seek(view: Any, u: float) -> None:
    settle(view)
    put(view, u)
    settle(view)


def pixels(view: Any) -> NDArray[np.uint8]:
    """Read the canvas [H, W, 3], in BGR."""
    settle(view)
    return drawn_pixels(view)


def drawn_pixels(view: Any) -> NDArray[np.uint8]:
    """Read the canvas [H, W, 3], in BGR, whether or not it waits for something."""
    url = view.eval_on_selector("#picture", "canvas => canvas.toDataURL()")
    image = cv2.imdecode(np.frombuffer(base64.b64decode(url.partition(",")[2]), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image, np.uint8)
