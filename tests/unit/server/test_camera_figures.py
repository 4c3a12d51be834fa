"""Focus and light of cameras' pictures: the figures against known values, and over REST."""

import io

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from rigs.toml import catalog_rig, dump_rig
from server.contact_sheet import camera_picture, contact_sheet, figures
from server.figures import figures_of
from server.schemas.pictures import BINS, CameraFigures
from server.services.services import Services
from server.store.looks import keep_look
from server.store.tables import Entry

PLANES = 60
RIG = catalog_rig("lab3x3").scaled(40, 24)


def figures_in(counts: np.ndarray, planes: int = PLANES) -> CameraFigures:
    place = {"id": "cam00", "row": 0, "column": 0, "planes": planes, "width": counts.shape[1], "height": len(counts)}
    return CameraFigures.model_validate(place | figures_of(counts.astype(np.uint32), planes))


def spikes_of(light: np.ndarray, planes: int = 100) -> np.ndarray:
    """Spikes [H, W] that a noisy sensor counts."""
    sensor = Sensor(light.shape[1], light.shape[0], "real", 1, 0)
    return sensor.expose(np.repeat(light[None].astype(np.float32), planes, axis=0)).sum(axis=0)


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    """Blocks of light [96, 120] from 0.05 to 0.5 spikes per tick."""
    blocks = np.random.default_rng(5).uniform(0.05, 0.5, (24, 30))
    return np.kron(blocks, np.ones((4, 4)))


# Figures


def test_an_even_picture_has_no_focus() -> None:
    found = figures_in(np.full((24, 40), 15))
    assert (found.focus, found.mean, found.under, found.over) == (0.0, 0.25, 0.0, 0.0)


def test_the_focus_is_the_normalised_variance_of_the_laplacian() -> None:
    counts = np.random.default_rng(3).integers(0, PLANES, (24, 40))
    kernel = np.array([1, 4, 6, 4, 1]) / 16
    smooth = cv2.sepFilter2D(counts.astype(np.float64), -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
    laplacian = cv2.Laplacian(smooth, cv2.CV_64F, borderType=cv2.BORDER_REPLICATE)
    assert figures_in(counts).focus == pytest.approx(1000 * laplacian.var() / counts.mean() ** 2, rel=1e-9)


@pytest.mark.parametrize("light", [1.0, 0.2, 0.05])
def test_a_blurred_picture_has_less_focus_however_dark_it_is(texture: np.ndarray, light: float) -> None:
    blurred = [texture if not sigma else cv2.GaussianBlur(texture, (0, 0), sigma) for sigma in (0, 0.7, 1, 1.5, 2, 3)]
    focus = [figures_in(spikes_of(light * one), 100).focus for one in blurred]
    assert focus == sorted(focus, reverse=True)


def test_more_light_is_not_more_focus() -> None:
    counts = np.random.default_rng(3).integers(0, 20, (24, 40))
    assert figures_in(3 * counts).focus == pytest.approx(figures_in(counts).focus, rel=1e-12)


def test_over_and_underexposed_pixels_are_counted_by_their_spikes() -> None:
    counts = np.full((10, 10), 30)
    counts[0, :7], counts[1, :4], counts[2, 0], counts[3, 0] = PLANES, 0, PLANES - 1, 1
    found = figures_in(counts)
    assert (found.over, found.under) == (0.07, 0.04)


def test_the_histogram_has_the_share_of_each_part() -> None:
    counts = np.array([[0, 1, 2, 31], [32, 63, 64, 64]])
    shares = np.zeros(BINS)
    for part, pixels in ((0, 2), (1, 1), (15, 1), (16, 1), (31, 3)):
        shares[part] = pixels / 8
    found = figures_in(counts, 64).histogram
    assert found == shares.tolist()
    drawn = figures_in(np.random.default_rng(3).integers(0, PLANES + 1, (77, 91))).histogram
    assert sum(drawn) == pytest.approx(1, abs=1e-12)


def test_one_pixel_has_figures() -> None:
    found = figures_in(np.array([[PLANES]]))
    assert (found.focus, found.mean, found.under, found.over, found.histogram[-1]) == (0.0, 1.0, 0.0, 1.0, 1.0)


def test_darkness_has_no_focus() -> None:
    found = figures_in(np.zeros((24, 40)))
    assert (found.focus, found.mean, found.under, found.histogram[0]) == (0.0, 0.0, 1.0, 1.0)


def test_no_plane_has_no_figures() -> None:
    found = figures_in(np.zeros((24, 40)), 0)
    assert (found.focus, found.mean, found.under, found.over, found.histogram) == (None, None, None, None, [])


# REST


@pytest.fixture(scope="module")
def capture_id(services: Services, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A capture whose camera `number` is dark in its first `number` columns and saturated in the next one."""
    folder, entries = tmp_path_factory.mktemp("dats"), services.store.entries
    for number, camera_id in enumerate(RIG.ids):
        planes = np.zeros((PLANES, 24, 40), dtype=np.uint8)
        planes[::2, :, number:] = 1
        planes[:, :, number] = 1
        (folder / f"{camera_id}.dat").write_bytes(pack(planes, PlaneLayout(40, 24)).tobytes())
    (folder / "rig.toml").write_text(dump_rig(RIG))
    entry = Entry(entries.dated_id("c"), "capture", "import", entries.now(), {})
    entries.add(entry)
    dats = [f"{camera_id}={folder / camera_id}.dat" for camera_id in RIG.ids]
    import_recording(dats, folder / "rig.toml", services.store.folder.recording(entry.id), ImportOptions(20000))
    return entry.id


def test_a_capture_has_the_figures_of_its_preview(http: TestClient, services: Services, capture_id: str) -> None:
    found = http.get(f"/v1/captures/{capture_id}/figures").json()
    assert found["capture"] == capture_id
    assert [(one["row"], one["column"]) for one in found["cameras"]] == [(n // 3, n % 3) for n in range(9)]
    camera = CameraFigures.model_validate(found["cameras"][5])
    assert (camera.id, camera.width, camera.height, camera.planes) == ("cam12", 40, 24, PLANES)
    assert (camera.under, camera.over, camera.histogram[16]) == (5 / 40, 1 / 40, 34 / 40)
    assert camera.mean == pytest.approx((1 + 34 / 2) / 40)
    kept = services.store.folder.entry(capture_id) / "figures.json"
    written = kept.stat().st_mtime_ns
    assert http.get(f"/v1/captures/{capture_id}/figures").json() == found
    assert kept.stat().st_mtime_ns == written
    assert http.get("/v1/captures/c20240101-000000-00000000/figures").status_code == 404


def test_a_look_is_kept_whole(http: TestClient, services: Services, capture_id: str) -> None:
    for path in ("look", "look/cam11", "look.png"):
        answer = http.get(f"/v1/rigs/lab3x3/{path}")
        assert (answer.status_code, "POST /v1/rigs/lab3x3/look" in answer.text) == (404, True)
    recording, rig = services.previews.recording(capture_id), services.store.folder.rig("lab3x3")
    pictures = {camera_id: camera_picture(recording, camera_id) for camera_id in RIG.ids}
    keep_look(rig, figures(recording), pictures)
    (rig / "look.png").write_bytes(contact_sheet(recording))
    found = http.get("/v1/rigs/lab3x3/look").json()
    assert (found["rig"], len(found["cameras"]), found["age_s"] < 60) == ("lab3x3", 9, True)
    assert found["cameras"] == http.get(f"/v1/captures/{capture_id}/figures").json()["cameras"]
    answer = http.get("/v1/rigs/lab3x3/look/cam12?of=x")
    assert (answer.content, answer.headers["content-type"]) == (pictures["cam12"], "image/png")
    assert np.asarray(Image.open(io.BytesIO(answer.content))).shape == (24, 40)
    headers = {"If-None-Match": answer.headers["etag"]}
    assert http.get("/v1/rigs/lab3x3/look/cam12", headers=headers).status_code == 304
    assert http.get("/v1/rigs/lab3x3/look/cam77").json()["detail"].startswith("found no camera cam77, expected one of")
    assert http.get("/v1/rigs/lab9x9/look").status_code == 404
    keep_look(rig, figures(recording), pictures | {"cam12": pictures["cam11"]})
    assert http.get("/v1/rigs/lab3x3/look").json()["etag"] != found["etag"]
    assert http.get("/v1/rigs/lab3x3/look/cam12", headers=headers).status_code == 200


def test_a_camera_without_a_plane_has_a_place_and_no_figures(services: Services, capture_id: str) -> None:
    recording = services.previews.recording(capture_id)
    entry = recording.manifest.camera("cam21")
    object.__setattr__(entry, "planes", 0)
    found = {one.id: one for one in figures(recording)}
    assert (found["cam21"].focus, found["cam21"].planes, found["cam21"].row, found["cam21"].width) == (None, 0, 2, 40)
    assert found["cam22"].focus
