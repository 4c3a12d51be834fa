"""Rigs whose names have characters that mean something in addresses are recorded with, and their captures found."""

from collections.abc import Iterator

import httpx
import pytest
from fastapi.testclient import TestClient

from server.app import create_app
from server.client import ServiceClient
from server.schemas.calibrations import CalibrationChoice
from server.schemas.captures import CaptureRequest
from server.settings import RigSource, ServiceSettings

NAMES = ["lab #2", "lab?", "50 % A", "Prüfstand 1"]


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceClient]:
    rigs = {name: RigSource(rig="ci3x3", devices="mock:fan_and_ball") for name in NAMES}
    app = create_app(ServiceSettings(data=tmp_path_factory.mktemp("data"), rigs=rigs))
    with TestClient(app, base_url="http://127.0.0.1") as http:
        yield ServiceClient(http)


@pytest.mark.parametrize("name", NAMES)
def test_a_rig_is_worked_with_by_its_name(client: ServiceClient, name: str) -> None:
    assert client.rig(name).id == client.rig_status(name).rig == name
    current = client.current_calibration(name)
    assert client.choose_calibration(current, CalibrationChoice(version=0)).rig == name
    made = client.start_capture(name, CaptureRequest(ticks=5))
    assert [one.id for one in client.captures(rig=name)] == [made.id]
    assert client.jobs(rig=name) == []


def test_nothing_of_a_name_is_read_as_a_part_of_an_address() -> None:
    asked: list[bytes] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.url.raw_path)
        return httpx.Response(200)

    client = ServiceClient(httpx.Client(base_url="http://lab.example", transport=httpx.MockTransport(answer)))
    client.look_picture("a/b #2?%41", "cam00")
    assert asked == [b"/v1/rigs/a%2Fb%20%232%3F%2541/look/cam00"]
