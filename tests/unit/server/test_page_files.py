"""The viewer's files: a closed list, with the policy they need, within the budgets of the house."""

import re
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from server.middleware import problems
from server.routes import page

FOLDER = Path(page.__file__).parents[1] / "page" / "viewer"
SCRIPTS = sorted(FOLDER.glob("*.js"))


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
    for name in imported - {"vendor/spark.js"} | {"viewer.js", "viewer.css"}:
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
