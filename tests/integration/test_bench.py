"""The documents others read the benches by."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow
NAMES = {
    "pixels": {"before_db", "defects_mended_db", "after_db", "gain_db"},
    "images": {
        *("tfp_x_numpy", "tfi_x_numpy", "tfp_fraction_of_copy", "tfp.gb_per_s", "tfi.planes_per_s"),
        *(
            f"{m}.{key}"
            for m in ("tfi", "tfp", "tfstp", "tvs", "slope", "adaptive", "interpolated")
            for key in ("psnr_db", "ms_per_image")
        ),
    },
    "rasterizer": {"gaussians", "forward_ms", "backward_ms", "x_reference", "two_thread_speedup", "steps_per_s"},
    "tuning": {"auto.trials", "tfi+4dgs.best.psnr_db", "dy-spikenerf.first.psnr_db", "tfi+d3dgs.best.motion"},
    "compact": {
        *(f"fan_and_ball.{score}" for score in ("ratio", "write_mb_s", "read_mb_s", "plane_ms")),
        *(f"{way}.ratio" for way in ("planes, zstd 7", "differences, zstd 7", "trains, zstd 7", "trains, zlib 6")),
    },
}


LONG = ("pixels", "images", "rasterizer", "tuning")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.long if n in LONG else ()) for n in NAMES])
def test_a_bench_prints_one_document(name, tmp_path):
    command = [sys.executable, "-m", "server.cli", "bench", name, "--quick", "--json", "--out", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    document = json.loads(result.stdout)
    assert set(document) == {"bench", "device", "revision", "scenes", "rows", "omissions", "refused", "summary"}
    assert set(document["summary"]) >= NAMES[name]
    assert all(value > 0 for value in document["summary"].values())
    assert all("seconds" in row for row in document["rows"])
    assert json.loads((tmp_path / f"{name}.json").read_text()) == document


def test_the_recorder_bench_accounts_for_every_block(tmp_path):
    command = [sys.executable, "-m", "server.cli", "bench", "recorder", "--quick", "--json", "--out", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    document = json.loads(result.stdout)
    summary = document["summary"]
    assert {"disk_mb_s", "lossfree_fraction_of_disk", "ram_gb_s", "memcpy_gb_s", "cores_at_60_percent"} <= set(summary)
    parser = [row for row in document["rows"] if row["case"].startswith("parser")]
    assert [row["case"] for row in parser] == ["parser, whole blocks", "parser, cut blocks"]
    for row in parser:
        assert row["blocks_per_s"] == pytest.approx(row["gb_s"] * 1e9 / 1_000_096)  # leader and trailer, 96 B
    assert {"parser_whole_gb_s", "parser_cut_blocks_per_s"} <= set(summary)
    assert summary["unreported_drops_at_120_percent"] == 0
    assert summary["drops_at_60_percent"] >= 0
    assert all("seconds" in row for row in document["rows"])
    assert json.loads((tmp_path / "recorder.json").read_text()) == document
    assert list((tmp_path / "work").iterdir()) == []
