"""The page: three files, served as they are."""

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse

router = APIRouter(include_in_schema=False)
_FOLDER = Path(__file__).parents[1] / "page"
_POLICY = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
_HEADERS = {"Content-Security-Policy": _POLICY}


@router.get("/")
def index() -> FileResponse:
    """The page itself."""
    return FileResponse(_FOLDER / "index.html", headers=_HEADERS)


@router.get("/page.css")
def style() -> FileResponse:
    """Its style."""
    return FileResponse(_FOLDER / "page.css", headers=_HEADERS)


@router.get("/page.js")
def script() -> FileResponse:
    """Its script."""
    return FileResponse(_FOLDER / "page.js", headers=_HEADERS)
