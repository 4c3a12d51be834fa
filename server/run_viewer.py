"""The viewer beside one run of this machine: its page, the files it plays and its recording, without a service."""

import json
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import FastAPI, Query
from fastapi.responses import FileResponse, RedirectResponse, Response

from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.run.folder import RunFolder
from rigs.errors import Spike4dgsError
from server.errors import NotFoundError
from server.middleware import problems
from server.middleware.guard import LoopbackGuard
from server.middleware.headers import SecurityHeaders
from server.routes import page
from server.routes.parameters import IfNoneMatch, png
from server.schemas.jobs import CameraPictures
from server.services.pictures import Pictured

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
    def pictures(_job: str) -> CameraPictures:
        return _pictured(run).described()

    @app.get("/v1/jobs/{_job}/pictures/{camera}")
    def picture(
        _job: str, camera: str, plane: Annotated[int, Query(ge=0)], if_none_match: IfNoneMatch = None
    ) -> Response:
        return png(if_none_match, _pictured(run).picture(camera, plane))

    app.include_router(page.router)
    problems.install(app)
    app.add_middleware(LoopbackGuard)
    app.add_middleware(SecurityHeaders)
    return app


def _pictured(run: Path) -> Pictured:
    """Return the recording that a run was made of; raises NotFoundError where it is no longer there."""
    white = float(json.loads((run / "viewer.json").read_text())["white"])
    try:
        recording = Recording.open(RunFolder.open(run).recording)
    except Spike4dgsError as error:
        raise NotFoundError(f"found no pictures beside a run ({error})", "the recording that it was made of") from error
    return Pictured(recording.path.name, white, recording)
