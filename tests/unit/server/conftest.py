"""A service without a worker, once a file: `http` asks it, `services` is what it asks."""

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient

from server.app import create_app
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
