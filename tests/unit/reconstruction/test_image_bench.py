import json
from functools import partial

import cv2
import numpy as np
import pytest

from acquisition.bench_document import BenchDocument
from acquisition.errors import BadRecordingError
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench import images as bench
from reconstruction.bench.contact_sheet import stack_sheets, write_sheet
from reconstruction.bench.conventions import SLOWER
from reconstruction.bench.decoding import tfi_recipe, tfp_recipe
from reconstruction.bench.diagrams import plot_images
from reconstruction.bench.images import Extent, ImageBench, finite, summarise
from reconstruction.bench.scores import CAR, Scorer, open_recording, score_recording
from reconstruction.bench.streams import TrueImage, slow_instant, slowed
from reconstruction.images.methods.tfi import tfi_intensities
from reconstruction.images.methods.tfp import tfp, tfp_intensities
from rigs.toml import catalog_rig


def stream_of(planes, row_order="bottom"):
    layout = PlaneLayout(planes.shape[2], planes.shape[1], row_order=row_order)
    return SpikeStream(pack(planes, layout), layout, 20000.0)


def test_the_recipes_give_the_same_images_as_ours():
    stream = stream_of(np.random.default_rng(0).random((200, 13, 21)) < np.linspace(0, 0.6, 21))
    planes = [0, 60, 199]
    np.testing.assert_allclose(tfi_recipe(stream, planes), tfi_intensities(stream, planes), rtol=1e-6)
    np.testing.assert_allclose(tfp_recipe(stream, planes), tfp_intensities(stream, planes), rtol=1e-6)


def test_dropping_keeps_every_kth_plane_and_reintegrating_keeps_every_spike():
    planes = np.random.default_rng(1).random((403, 5, 7)) < 0.4
    stream = stream_of(planes)
    dropped, gathered = slowed(stream, 10, "drop"), slowed(stream, 10, "reintegrate")
    assert dropped.tick_rate_hz == gathered.tick_rate_hz == 2000
    np.testing.assert_array_equal(dropped.planes(0, 41), planes[::10])
    spikes = gathered.planes(0, len(gathered)).sum(axis=0)
    assert len(gathered) == 40
    left = planes[:400].sum(axis=0) - 10 * spikes.astype(int)
    assert abs(left).max() < 10
    np.testing.assert_array_equal(slowed(stream, 1, "reintegrate").planes(0, 403), planes)


def test_reintegrated_pixels_begin_at_phases_of_their_own():
    steady = stream_of(np.ones((100, 30, 40), dtype=bool))  # each pixel fires in every plane
    shares = slowed(steady, 10, "reintegrate", seed=1).planes(0, 10)
    assert shares.all()
    half = stream_of(np.broadcast_to(np.arange(100)[:, None, None] % 2 == 0, (100, 30, 40)))
    slow = slowed(half, 10, "reintegrate", seed=1).planes(0, 10).mean(axis=(1, 2))
    np.testing.assert_allclose(slow, 0.5, atol=0.1)  # in step they would all fire in every second plane
    assert not np.array_equal(slowed(half, 10, "reintegrate", seed=2).packed, slowed(half, 10, "reintegrate").packed)


@pytest.mark.parametrize(
    ("k", "how", "wanted"), [(1, "reintegrate", (200, 200)), (40, "drop", (5, 200)), (40, "reintegrate", (5, 219.5))]
)
def test_a_slow_instant_is_in_the_middle_of_its_light(k, how, wanted):
    assert slow_instant(200, k, how) == wanted


def test_a_finished_part_is_kept_and_another_extent_measures_again(tmp_path, monkeypatch):
    runs = []
    monkeypatch.setattr(ImageBench, "_decoding", lambda self, document: runs.append(self._extent.scenes[0]))
    monkeypatch.setattr(ImageBench, "_scene", lambda self, document, scene, seed: _one_row(document, scene, runs))
    for extent in (Extent(("a",), (1,), False), Extent(("a", "b"), (1,), False), Extent(("b",), (1,), False)):
        document = ImageBench(extent, tmp_path).run()
        assert [row["scene"] for row in document.rows] == list(extent.scenes)
    assert runs == ["a", "a-row", "b-row", "b", "b-row"]
    assert json.loads((tmp_path / "a-1.json").read_text())["result"]["rows"][0]["scene"] == "a"


def _one_row(document, scene, runs):
    runs.append(f"{scene}-row")
    document.rows.append(
        {"part": "scenes", "method": "tfp", "scene": scene, "light": 1.0, "rate_by": "full", "psnr_db": 20.0}
        | {"rate_hz": 20000.0, "seconds": 0.001}
    )


def test_a_method_that_refuses_is_an_omission(monkeypatch):
    def absent(stream, plane):
        raise BadRecordingError("found no weights, expected some; train them")

    monkeypatch.setattr(bench, "METHODS", {"tfp": tfp, "absent": absent})
    planner = ImageBench(Extent(("a",), (1,), False))
    document = BenchDocument("images")
    truth = TrueImage(np.full((16, 16), 0.5, np.float32), 0.6, np.zeros((16, 16), bool))
    score = partial(Scorer(None).against, truth=truth)
    planner._measure(document, {"scene": "a"}, stream_of(np.ones((9, 16, 16))), (4,), [score])
    assert [row["method"] for row in document.rows] == ["tfp"]
    assert document.rows[0]["psnr_db"] == pytest.approx(1.58, abs=0.01)
    assert "dynamic_psnr_db" not in document.rows[0]  # nothing moves
    assert document.omissions == ["absent: found no weights, expected some; train them"]


def test_the_summary_has_a_mean_for_each_light_and_rate():
    base = {"part": "scenes", "method": "m", "light": 1.0, "rate_hz": 20000.0, "rate_by": "full", "seconds": 0.002}
    document = BenchDocument("images")
    document.rows = [
        base | {"psnr_db": 30.0},
        base | {"psnr_db": 32.0},
        base | {"psnr_db": 20.0, "light": 0.1},
        base | {"psnr_db": 10.0, "rate_hz": 100.0, "rate_by": "drop"},
        base | {"psnr_db": 12.0, "rate_hz": 100.0, "rate_by": "reintegrate"},
    ]
    summarise(document)
    assert document.summary == {
        "m.psnr_db": 31.0,
        "m.ms_per_image": 2.0,
        "m.psnr_db@light0.1": 20.0,
        "m.psnr_db@drop100": 10.0,
        "m.psnr_db@reintegrate100": 12.0,
    }
    assert finite({"a": 1.0, "b": float("nan"), "c": float("inf")}) == {"a": 1.0}


def test_without_parameters_metrics_are_omissions(tmp_path):
    for folder in (None, tmp_path):
        scorer = Scorer(folder)
        assert [line.split(":")[0] for line in scorer.omissions] == ["lpips", "brisque", "niqe"]
        assert scorer.alone(np.full((20, 20), 0.3, np.float32), 0.6) == {}


def test_the_synthetic_recording_is_scored_after_one_gain(tmp_path):
    truth = np.random.default_rng(0).integers(0, 231, (40, 50), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "truth.png"), truth)
    image = (truth / 255 * 0.6).astype(np.float32)
    found = score_recording(Scorer(None), image, tmp_path / "truth.png")
    assert found["gain"] == pytest.approx(1 / 0.6, rel=1e-5)
    assert found["psnr_db"] > 100
    dark = score_recording(Scorer(None), 0 * image, tmp_path / "truth.png")
    assert np.isfinite(dark["psnr_db"])


def test_recordings_that_are_not_there_are_omissions(tmp_path, monkeypatch):
    monkeypatch.setenv("SPIKE4DGS_SHARED", str(tmp_path))
    document = BenchDocument("images")
    ImageBench(Extent(("a",), (1,)))._recording(document, CAR)
    assert document.omissions == [f"{CAR}: not found in $SPIKE4DGS_SHARED/spikedata"]


def test_an_upright_npz_becomes_a_stream(tmp_path):
    planes = np.random.default_rng(0).integers(0, 2, (9, 5, 11), dtype=np.uint8)
    np.savez(tmp_path / "spikes.npz", spk=planes)
    np.testing.assert_array_equal(open_recording(tmp_path / "spikes.npz").planes(0, 9), planes)


def test_titled_pictures_make_one_sheet_and_rows_a_plot(tmp_path):
    tiles = [("grey", np.full((10, 400), 200, np.uint8)), ("coloured", np.full((10, 400, 3), 200, np.uint8))]
    write_sheet(tmp_path / "sheet.png", [tiles, tiles])
    assert cv2.imread(str(tmp_path / "sheet.png")).shape == (64, 808, 3)
    write_sheet(tmp_path / "sheet.png", [tiles * 2])
    assert cv2.imread(str(tmp_path / "sheet.png")).shape == (32 * 1200 // 1616, 1200, 3)
    stack_sheets(tmp_path / "both.jpg", [tmp_path / "sheet.png"] * 2)
    both = cv2.imread(str(tmp_path / "both.jpg")).astype(int)
    assert np.abs(both - np.tile(cv2.imread(str(tmp_path / "sheet.png")), (2, 1, 1))).mean() < 3
    base = {"part": "scenes", "method": "m", "light": 1.0, "rate_hz": 2e4, "rate_by": "full", "seconds": 0.002}
    rows = [base | {"psnr_db": 30.0}, base | {"psnr_db": 20.0, "light": 0.1}]
    plot_images(tmp_path / "plot.png", {"rows": rows, "device": {"processor": "p", "threads": 2}, "revision": "r"})
    assert (tmp_path / "plot.png").stat().st_size > 10_000


@pytest.mark.slow
def test_one_scene_at_every_light_and_rate(tmp_path, monkeypatch):
    """A small camera and a short clip through all of it."""
    rig = catalog_rig("lab3x3").scaled(80, 50)
    monkeypatch.setattr(bench, "catalog_rig", lambda name: rig)
    monkeypatch.setenv("SPIKE4DGS_SHARED", str(tmp_path))
    document = ImageBench(Extent(("fan_and_ball",), (1,)), tmp_path / "work").run()
    rows = [row for row in document.rows if row.get("part") == "scenes"]
    assert len(rows) == len(bench.METHODS) * (1 + len(bench.LEVELS) + 2 * len(SLOWER))
    summary = document.summary
    assert summary["adaptive.psnr_db"] > summary["tfi.psnr_db"] + 3
    assert summary["adaptive.psnr_db@light0.1"] < summary["adaptive.psnr_db"]
    assert summary["adaptive.psnr_db@drop100"] < summary["adaptive.psnr_db@drop10000"]
    assert {"tfp_x_numpy", "tfi_x_numpy", "tfp_fraction_of_copy"} <= set(summary)
