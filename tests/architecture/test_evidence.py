"""Every figure of EVIDENCE.md stands in a committed JSON."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROW = re.compile(r"^\| `([^`]+)` \| ([-+.\deE]+) \|$", re.MULTILINE)
BENCHES = ("training", "poses", "images", "rasterizer", "recorder", "faults", "service_load")


def tables():
    """Rows by bench: each section names its JSON."""
    found = {}
    for section in (ROOT / "EVIDENCE.md").read_text().split("\n## "):
        for bench in BENCHES:
            if f"({'tests/benchmarks'}/{bench}.json)" in section:
                found[bench] = ROW.findall(section)
    return found


@pytest.mark.parametrize("bench", BENCHES)
def test_the_table_is_the_summary_of_its_json(bench):
    summary = json.loads((ROOT / "tests" / "benchmarks" / f"{bench}.json").read_text())["summary"]
    rows = tables()[bench]
    assert rows
    for name, value in rows:
        digits = len(value.partition(".")[2])
        assert f"{summary[name]:.{digits}f}" == value, name
