"""A service without a worker, once a file: `http` asks it, `services` is what it asks. And benches that do not run."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from acquisition.bench_document import BenchDocument
from server.app import create_app
from server.cli.bench_asked import Asked
from server.cli.bench_runs import BENCHES
from server.services.services import Services
from server.settings import ServiceSettings


@pytest.fixture(scope="module")
def http(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    settings = ServiceSettings(data=tmp_path_factory.mktemp("data"))
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as client:
        yield client


@pytest.fixture(scope="module")
def services(http: TestClient) -> Services:
    return http.app.state.services  # type: ignore[attr-defined]


@pytest.fixture
def unrun(monkeypatch: pytest.MonkeyPatch) -> Callable[[type, str, Asked], Any]:
    """Make the bench of a kind that a name and options ask for, without running it."""

    def made(kind: type, name: str, asked: Asked) -> Any:
        benches: list[Any] = []

        def keep(bench: Any) -> BenchDocument:
            benches.append(bench)
            return BenchDocument(name)

        monkeypatch.setattr(kind, "run", keep)
        BENCHES[name].run(asked)
        return benches.pop()

    return made
