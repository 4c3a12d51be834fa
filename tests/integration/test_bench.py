"""The documents others read the benches by."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow
NAMES = {
    "images": {"tfp_x_numpy", "tfp_fraction_of_copy", "tfi.psnr_db", "tfi.ms_per_image", "tfp.psnr_db"},
    "rasterizer": {"gaussians", "forward_ms", "backward_ms", "x_reference", "two_thread_speedup", "steps_per_s"},
}


@pytest.mark.parametrize("name", NAMES)
def test_a_bench_prints_one_document(name, tmp_path):
    command = [sys.executable, "-m", "server.cli", "bench", name, "--json", "--out", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    document = json.loads(result.stdout)
    assert set(document) == {"bench", "device", "revision", "rows", "omissions", "summary"}
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
    assert summary["unreported_drops_at_120_percent"] == 0
    assert summary["drops_at_60_percent"] >= 0
    assert all("seconds" in row for row in document["rows"])
    assert json.loads((tmp_path / "recorder.json").read_text()) == document
    assert list((tmp_path / "work").iterdir()) == []
