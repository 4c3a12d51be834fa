"""The pages: files served as they are, from a closed list."""

from collections.abc import Callable
from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse

from server.errors import NotFoundError

router = APIRouter(include_in_schema=False)
_FOLDER = Path(__file__).parents[1] / "page"
_SAFE = "object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
_PLAIN = f"default-src 'self'; img-src 'self' data:; {_SAFE}"
# Whatever is fetched with a token is shown as a blob.
_PAGE = f"default-src 'self'; img-src 'self' data: blob:; media-src 'self' blob:; {_SAFE}"
# A report is shown in a sandbox and has its style inline.
_REPORT = f"default-src 'self'; img-src data:; media-src data:; style-src 'self' 'unsafe-inline'; {_SAFE}"
# The viewer's renderer compiles WebAssembly and sorts in a worker that it makes of a blob.
_VIEWER = f"default-src 'self'; img-src 'self' data:; script-src 'self' 'wasm-unsafe-eval'; worker-src blob:; {_SAFE}"
_FILES = {  # address: (file, content security policy)
    "/": ("index.html", _PAGE),
    "/report.html": ("report.html", _REPORT),
    "/viewer.html": ("viewer/viewer.html", _VIEWER),
    "/page.css": ("page.css", _PLAIN),
    "/large.css": ("large.css", _PLAIN),
    "/page.js": ("page.js", _PLAIN),
}
_OPERATOR_FILES = sorted(path.name for path in (_FOLDER / "operator").glob("*.js"))
_VIEWER_SCRIPTS = sorted(path.name for path in (_FOLDER / "viewer").glob("*.js") if path.name != "bundle.js")
_VIEWER_FILES = ["viewer.css", *_VIEWER_SCRIPTS, "vendor/spark.js"]  # without what the renderer is bundled from


def _served(file: str, policy: str) -> Callable[[], FileResponse]:
    """Return a route that answers with a file."""
    return lambda: FileResponse(_FOLDER / file, headers={"Content-Security-Policy": policy})


for _address, (_file, _policy) in _FILES.items():
    router.add_api_route(_address, _served(_file, _policy))


@router.get("/operator/{name}")
def operator_file(name: str) -> FileResponse:
    """Return a module of the page's script. Raises NotFoundError."""
    return _listed("operator", name, _OPERATOR_FILES, _PLAIN)


@router.get("/viewer/{name:path}")
def viewer_file(name: str) -> FileResponse:
    """Return a style or script of the viewer.

    Raises NotFoundError, also for the renderer where `make viewer` has not been run.
    """
    return _listed("viewer", name, _VIEWER_FILES, _VIEWER)


def _listed(folder: str, name: str, names: list[str], policy: str) -> FileResponse:
    if name not in names or not (_FOLDER / folder / name).is_file():
        raise NotFoundError(f"found no /{folder}/{name[:60]}", f"one of {', '.join(names)}")
    return FileResponse(_FOLDER / folder / name, headers={"Content-Security-Policy": policy})
