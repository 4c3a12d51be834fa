"""`bench paper --quick`: recorded, reconstructed, scored, written; and found again."""

import json
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow


def bench(out, *options):
    command = [sys.executable, "-m", "server.cli", "bench", "paper", "--quick", "--json", "--out", str(out), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def test_the_quick_bench_writes_its_tables_and_finds_them_again(tmp_path):
    result = bench(tmp_path)
    assert result.returncode == 0, result.stderr
    document = json.loads(result.stdout)
    assert json.loads((tmp_path / "paper.json").read_text()) == document
    assert [r["method"] for r in document["rows"]] == ["auto", "auto.drop10000", "tfi+4dgs-small"]
    assert all(r["steps"] == 40 and r["seconds"] > 0 and r["psnr_db"] > 15 for r in document["rows"])
    assert document["summary"]["rates.auto.psnr_db@40steps"] == pytest.approx(document["rows"][0]["psnr_db"])
    assert any(line.startswith("rates, DUSt3R: no DUSt3R") for line in document["omissions"])
    text = (tmp_path / "paper.md").read_text()
    assert "| TFI + small 4DGS | 40 steps | " in text
    assert (tmp_path / "paper-rates.png").stat().st_size > 10_000
    again = bench(tmp_path, "--limit-s", "0")
    assert json.loads(again.stdout)["rows"] == document["rows"]


def test_a_table_that_is_not_there_is_refused_in_one_line(tmp_path):
    result = bench(tmp_path, "--table", "nothing")
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == "spike4dgs: found the tables nothing, expected some of rates\n"
