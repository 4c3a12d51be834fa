"""Every figure and every table of EVIDENCE.md is what the committed documents say."""

import re
from pathlib import Path

import pytest

from reconstruction.bench.evidence import BLOCK, FIGURE, LINK, figures_filled, read_documents

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = read_documents(ROOT / "tests" / "benchmarks")
TEXT = (ROOT / "EVIDENCE.md").read_text()


def test_nothing_is_left_to_fill():
    assert figures_filled(TEXT, DOCUMENTS) == TEXT, "run `make evidence`"


@pytest.mark.parametrize("name", sorted(set(LINK.findall(TEXT))))
def test_a_linked_document_is_there_and_stands_behind_a_figure_or_a_table(name):
    assert name in DOCUMENTS
    shown = [s for s in TEXT.split("\n## ") if f"(tests/benchmarks/{name}.json)" in s]
    assert any(FIGURE.search(section) or BLOCK.search(section) for section in shown)


def test_every_picture_is_committed():
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+)\)", TEXT + (ROOT / "README.md").read_text())
    assert pictures
    assert [p for p in pictures if not (ROOT / p).exists()] == []


def test_no_block_is_empty():
    assert BLOCK.findall(TEXT)
    for found in BLOCK.finditer(TEXT):
        assert found[0].count("\n") > 2, f"{found[2]} {found[3]}: run `make evidence`"
