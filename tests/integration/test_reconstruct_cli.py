"""Tests reconstruction from the command line, and its answers to wrong input."""

import numpy as np
import pytest

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack, unpack
from reconstruction.rendering.gsplat_backend import why_unavailable


def test_a_stage_leaves_its_mark_only_where_it_succeeds(spike4dgs, tmp_path, monkeypatch):
    mark = tmp_path / "finished"

    def stage(*arguments):
        monkeypatch.setenv("SPIKE4DGS_FINISHED", str(mark))
        return spike4dgs(*arguments)

    assert stage("verify", tmp_path).refused("recording")
    assert not mark.exists()
    assert stage("--version").status == 0
    assert mark.exists()


@pytest.fixture
def dat(tmp_path):
    planes = np.random.default_rng(0).integers(0, 2, (64, 26, 41))
    file = tmp_path / "camera.dat"
    file.write_bytes(pack(planes, PlaneLayout(41, 26)).tobytes())
    return file


@pytest.mark.parametrize("method", ["tfi", "tfstp", "adaptive"])
def test_images_of_a_bare_file(spike4dgs, dat, tmp_path, method):
    out = tmp_path / "out"
    result = spike4dgs(
        "images", dat, "--size", "41x26", "--tick-rate", 20000, "--method", method, "--ticks", "10:31:10", "--out", out
    )
    assert result.status == 0, result.lines
    assert sorted(f.name for f in out.iterdir()) == sorted(
        f"{prefix}{plane:06d}{suffix}"
        for plane in (10, 20, 30)
        for prefix, suffix in (("", ".npy"), ("valid_", ".npy"), ("", ".png"))
    )
    image = np.load(out / "000010.npy")
    assert image.dtype == np.float32
    assert image.shape == (26, 41)
    assert np.isfinite(image).all()


def test_images_refuse_what_they_cannot_use(spike4dgs, dat, tmp_path):
    out, empty = tmp_path / "out", tmp_path / "empty.dat"
    empty.write_bytes(b"")
    size = ("--size", "41x26", "--tick-rate", 20000)
    assert spike4dgs("images", dat, *size, "--method", "crystal", "--out", out).refused("crystal", "tfi, tfp")
    assert spike4dgs("images", dat, *size, "--method", "tfi", "--ticks", "90:91:1", "--out", out).refused("plane 90")
    assert spike4dgs("images", empty, *size, "--method", "tfi", "--out", out).refused("empty.dat", "0 bytes")
    assert spike4dgs("images", dat, "--method", "tfi", "--out", out).refused("--size")
    rest = ("--tick-rate", 20000, "--method", "tfi", "--out", out)
    assert spike4dgs("images", dat, "--size", "40x26", *rest).refused("bytes")
    assert spike4dgs("images", dat, "--size", "big", *rest).refused("400x250")
    assert not out.exists()


def test_reconstruct_refuses_what_is_no_recording(spike4dgs, tmp_path):
    assert spike4dgs("reconstruct", tmp_path / "nothing", "--out", tmp_path / "run").refused("nothing")
    assert spike4dgs("render", tmp_path, "--cameras", "t.json", "--out", tmp_path / "o").refused("run.json")
    assert spike4dgs("evaluate", tmp_path / "nothing").refused("run.json")
    assert spike4dgs("levitate").refused("levitate")
    assert not (tmp_path / "run").exists()


@pytest.mark.skipif(why_unavailable() is None, reason="gsplat and a CUDA device are here")
def test_a_gpu_that_is_not_here_is_refused_before_anything_else(spike4dgs, tmp_path):
    result = spike4dgs("reconstruct", tmp_path / "rec", "--device", "cuda", "--out", tmp_path / "run")
    assert result.refused(f"found no GPU to train on ({why_unavailable()})", "expected gsplat and a CUDA device")
    assert len(result.lines) == 1
    assert not (tmp_path / "run").exists()


def test_the_real_car_is_upright_and_both_methods_agree(spike4dgs, spikedata, tmp_path):
    means = {}
    for method in ("tfi", "tfp"):
        out = tmp_path / method
        result = spike4dgs(
            "images", spikedata / "histsflow_car.dat", "--size", "400x250", "--tick-rate", 20000,
            "--method", method, "--ticks", "100:101:1", "--out", out,
        )  # fmt: skip
        assert result.status == 0, result.lines
        image = np.load(out / "000100.npy")
        means[method] = image.mean()
        assert image[:50, :80].mean() > 2 * image[200:, :80].mean()  # bright sky, dark road
    assert means["tfi"] == pytest.approx(means["tfp"], rel=0.01)


def test_the_real_car_packs_back_to_its_own_bytes(spikedata):
    raw = np.fromfile(spikedata / "histsflow_car.dat", np.uint8).reshape(200, 12500)
    layout = PlaneLayout(400, 250)
    assert np.array_equal(pack(unpack(raw, layout), layout), raw)
