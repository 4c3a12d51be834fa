"""Figures in a text follow the documents they come from."""

import pytest

from reconstruction.bench.evidence import figures_filled, hours
from reconstruction.errors import BadRunError

TEXT = """# Evidence
## One
[a](tests/benchmarks/one.json)
| figure | value |
| `a.db` | 1.00 |
| `count` | 7 |
## Two
[b](tests/benchmarks/two.json)
| `a.db` | 3.000 |
"""
ONE = {"summary": {"a.db": 2.345, "count": 12}, "rows": [{"seconds": 1800}, {"seconds": None}, {}]}
TWO = {"summary": {"a.db": -0.5}, "rows": [{"seconds": 3600}]}


def test_each_section_takes_its_own_document_and_keeps_its_digits():
    filled = figures_filled(TEXT, {"one": ONE, "two": TWO})
    assert "| `a.db` | 2.35 |" in filled or "| `a.db` | 2.34 |" in filled
    assert "| `count` | 12 |" in filled
    assert "| `a.db` | -0.500 |" in filled
    assert figures_filled(filled, {"one": ONE, "two": TWO}) == filled


def test_a_figure_nobody_measured_is_refused():
    with pytest.raises(BadRunError, match=r"found the figure count.*one\.json"):
        figures_filled(TEXT, {"one": {"summary": {"a.db": 1.0}, "rows": []}, "two": TWO})


def test_hours_are_those_of_all_rows():
    assert hours({"one": ONE, "two": TWO}) == pytest.approx(1.5)
