"""The viewer beside one run of this machine: its page and the files it plays, without a service."""

from pathlib import Path
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI
from fastapi.responses import FileResponse, RedirectResponse

from reconstruction.errors import BadRunError
from server.errors import NotFoundError
from server.middleware import problems
from server.middleware.guard import LoopbackGuard
from server.middleware.headers import SecurityHeaders
from server.routes import page

PLAYED = ("viewer.json", "viewer.bin")


def viewer_app(run: Path) -> FastAPI:
    """Return an application whose one page is the viewer with the scene of the folder `run`.

    To the page the run is a job with the folder's name. Raises BadRunError for a folder that has nothing to play.
    """
    for name in PLAYED:
        if not (run / name).is_file():
            raise BadRunError(f"found no {name}", "a run with its report", "reconstruct it to the end", where=run)
    app = FastAPI(openapi_url=None)
    job = run.resolve().name

    @app.get("/")
    def begin() -> RedirectResponse:
        return RedirectResponse(f"/viewer.html?job={quote(job)}")

    @app.get("/v1/jobs/{_job}")
    def described(_job: str) -> dict[str, Any]:
        return {"id": job, "type": "reconstruct", "name": job, "request": {}}

    @app.get("/v1/jobs/{_job}/artefacts/{name}")
    def artefact(_job: str, name: str) -> FileResponse:
        if name not in PLAYED:
            raise NotFoundError(f"found no artefact {name[:60]}", " or ".join(PLAYED))
        return FileResponse(run / name)

    @app.get("/v1/jobs/{_job}/pictures")
    def pictures(_job: str) -> None:
        raise NotFoundError("found no pictures beside a run", "a job of a service")

    app.include_router(page.router)
    problems.install(app)
    app.add_middleware(LoopbackGuard)
    app.add_middleware(SecurityHeaders)
    return app
