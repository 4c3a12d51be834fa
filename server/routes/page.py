"""The pages: files served as they are, from a closed list."""

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse

from server.errors import NotFoundError

router = APIRouter(include_in_schema=False)
_FOLDER = Path(__file__).parents[1] / "page"
_SAFE = "object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
_HEADERS = {"Content-Security-Policy": f"default-src 'self'; img-src 'self' data:; {_SAFE}"}
# What is fetched with a token is shown as a blob; a report is shown in a sandbox and has its style inline.
_BLOBS = f"default-src 'self'; img-src 'self' data: blob:; media-src 'self' blob:; {_SAFE}"
_PAGE_HEADERS = {"Content-Security-Policy": _BLOBS}
_REPORT_POLICY = "default-src 'self'; img-src data:; media-src data:; style-src 'self' 'unsafe-inline'"
_REPORT_HEADERS = {"Content-Security-Policy": f"{_REPORT_POLICY}; {_SAFE}"}
_SCRIPTS = "act api calibrations captures curve dialogs dom jobs live media options report results rigs"
_OPERATOR_FILES = tuple(f"{name}.js" for name in _SCRIPTS.split())
# The viewer's renderer compiles WebAssembly and sorts in a worker that it makes of a blob.
_VIEWER_POLICY = "default-src 'self'; img-src 'self' data:; script-src 'self' 'wasm-unsafe-eval'; worker-src blob:"
_VIEWER_HEADERS = {"Content-Security-Policy": f"{_VIEWER_POLICY}; {_SAFE}"}
_VIEWER_SCRIPTS = ("viewer", "scene", "motion", "splats", "picture", "view", "cameras", "controls", "vendor/spark")
_VIEWER_FILES = ("viewer.css", *(f"{name}.js" for name in _VIEWER_SCRIPTS))


@router.get("/")
def index() -> FileResponse:
    """The page itself."""
    return FileResponse(_FOLDER / "index.html", headers=_PAGE_HEADERS)


@router.get("/operator/{name}")
def operator_file(name: str) -> FileResponse:
    """A module of its script; raises NotFoundError."""
    if name not in _OPERATOR_FILES:
        raise NotFoundError(f"found no /operator/{name[:60]}", f"one of {', '.join(_OPERATOR_FILES)}")
    return FileResponse(_FOLDER / "operator" / name, headers=_HEADERS)


@router.get("/report.html")
def report() -> FileResponse:
    """The page that shows a job's report, where it can do nothing; the job is named in the query."""
    return FileResponse(_FOLDER / "report.html", headers=_REPORT_HEADERS)


@router.get("/page.css")
def style() -> FileResponse:
    """Its style."""
    return FileResponse(_FOLDER / "page.css", headers=_HEADERS)


@router.get("/page.js")
def script() -> FileResponse:
    """Its script."""
    return FileResponse(_FOLDER / "page.js", headers=_HEADERS)


@router.get("/token.js")
def token() -> FileResponse:
    """What the pages share: the token in their requests."""
    return FileResponse(_FOLDER / "token.js", headers=_HEADERS)


@router.get("/viewer.html")
def viewer() -> FileResponse:
    """The page that plays a job's scene; the job is named in the query."""
    return FileResponse(_FOLDER / "viewer" / "viewer.html", headers=_VIEWER_HEADERS)


@router.get("/viewer/{name:path}")
def viewer_file(name: str) -> FileResponse:
    """Its style and scripts; raises NotFoundError, for the renderer too where `make viewer` has not been run."""
    path = _FOLDER / "viewer" / name
    if name not in _VIEWER_FILES or not path.is_file():
        raise NotFoundError(f"found no /viewer/{name[:60]}", f"one of {', '.join(_VIEWER_FILES)}")
    return FileResponse(path, headers=_VIEWER_HEADERS)
