"""Uploads looked into over REST before they are imported."""

import io
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from acquisition.recording.inspection import middle_planes
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from server.app import create_app
from server.services import inspections
from server.settings import ServiceSettings

LAYOUT = PlaneLayout(400, 250)


@pytest.fixture(scope="module")
def data() -> bytes:
    """60 planes of blocks of light, brighter to the right and in the upper half."""
    rng = np.random.default_rng(1)
    light = np.kron(rng.uniform(0.05, 0.3, (25, 40)), np.ones((10, 10))) * np.linspace(0.2, 1, 400)
    light[:125] *= 2
    spikes = Sensor(400, 250, "real", 1, 0).expose(np.repeat(light[None].astype(np.float32), 60, axis=0))
    return pack(spikes, LAYOUT).tobytes()


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as client:
        yield client


def begun(http: TestClient, size: int, data: bytes) -> str:
    """An upload of `size` bytes of which `data` have come."""
    made = http.post("/v1/uploads", json={"name": "cam00.dat", "bytes": size}).json()["id"]
    if data:
        assert http.patch(f"/v1/uploads/{made}", content=data, headers={"Upload-Offset": "0"}).status_code == 200
    return f"/v1/uploads/{made}"


def test_the_layout_is_told_before_the_whole_upload_has_come(http: TestClient, data: bytes) -> None:
    where = begun(http, 100 * 12_500, data)
    found = http.get(f"{where}/inspection").json()
    best = found["candidates"][0]
    assert (best["format"], best["width"], best["height"], best["bit_order"]) == ("vidar", 400, 250, "lsb")
    assert (best["planes"], best["left_bytes"], found["doubt"]) == (100, 0, None)
    assert best["plausibility"] > 0.3 > found["candidates"][-1]["plausibility"]
    assert (found["bytes"], found["received"]) == (1_250_000, len(data))


def test_a_size_can_be_given(http: TestClient, data: bytes) -> None:
    where = begun(http, len(data), data)
    found = http.get(f"{where}/inspection?width=200&height=100").json()
    assert {(one["width"], one["height"]) for one in found["candidates"]} == {(200, 100)}
    assert found["candidates"][0]["plausibility"] < 0.5
    for half in ("width=200", "height=100"):
        answer = http.get(f"{where}/inspection?{half}")
        assert (answer.status_code, "found one of width and height" in answer.json()["detail"]) == (422, True)


def test_what_does_not_fit_is_one_line(http: TestClient, data: bytes) -> None:
    partial = http.get(f"{begun(http, len(data) + 5, data)}/inspection").json()
    assert partial["doubt"] == "found 5 bytes behind 60 whole planes of 400x250"
    noise = np.random.default_rng(0).integers(0, 256, 500_000, dtype=np.uint8).tobytes()
    assert "neighbouring pixels unlike" in http.get(f"{begun(http, len(noise), noise)}/inspection").json()["doubt"]
    short = http.get(f"{begun(http, 5, b'hello')}/inspection").json()
    assert (short["candidates"], short["doubt"].startswith("found 5 bytes, less than a plane of 400x250")) == ([], True)
    assert http.get("/v1/uploads/u20240101-000000-00000000/inspection").status_code == 404


def test_a_preview_is_the_picture_in_the_layout_asked_for(http: TestClient, data: bytes) -> None:
    where = begun(http, len(data), data)
    answer = http.get(f"{where}/preview?width=400&height=250")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "image/png")
    picture = np.asarray(Image.open(io.BytesIO(answer.content))).astype(float)
    assert picture.shape == (250, 400)
    assert picture[:125].mean() > 1.2 * picture[125:].mean()
    flipped = http.get(f"{where}/preview?width=400&height=250&row_order=top").content
    assert (np.asarray(Image.open(io.BytesIO(flipped))) == picture[::-1]).all()
    headers = {"If-None-Match": answer.headers["etag"]}
    assert http.get(f"{where}/preview?width=400&height=250", headers=headers).status_code == 304


@pytest.mark.parametrize(
    ("query", "status", "words"),
    [
        ("", 422, "width and height"),
        ("?width=400", 422, "width and height"),
        ("?width=9999&height=9999", 409, "a plane"),
        ("?format=m1k40", 422, "M1K40"),
        ("?format=mp4&width=4&height=4", 422, "format"),
        ("?colour=red", 422, "colour"),
    ],
)
def test_a_preview_that_cannot_be_is_refused(
    http: TestClient, data: bytes, query: str, status: int, words: str
) -> None:
    answer = http.get(f"{begun(http, len(data), data)}/preview{query}")
    assert (answer.status_code, words in answer.json()["detail"]) == (status, True)


def test_nothing_has_come_yet(http: TestClient) -> None:
    where = begun(http, 12_500, b"")
    assert http.get(f"{where}/inspection").json()["candidates"] == []
    assert http.get(f"{where}/preview?width=400&height=250").status_code == 409


def test_a_picture_of_more_pixels_than_a_camera_has_is_refused(http: TestClient) -> None:
    where = begun(http, 2_600_000, bytes(2_600_000))
    answer = http.get(f"{where}/preview?width=5000&height=4000")
    assert answer.status_code == 422
    assert "found a picture of 5000x4000, expected at most 4000000 pixels" in answer.json()["detail"]


def test_an_upload_that_is_cut_off_while_it_is_looked_at_is_told(
    http: TestClient, data: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    where = begun(http, len(data), data)
    stored = tmp_path / "uploads" / where.rsplit("/", 1)[1] / "data"

    def cut_off(come: object, source_format: str, layout: PlaneLayout) -> object:
        os.truncate(stored, 1_000)
        return middle_planes(come, source_format, layout)  # type: ignore[arg-type]

    monkeypatch.setattr(inspections, "middle_planes", cut_off)
    answer = http.get(f"{where}/preview?width=400&height=250")
    assert (answer.status_code, "cut off" in answer.json()["detail"]) == (409, True)
