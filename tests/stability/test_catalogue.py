"""The stress catalogue on every backend: each case within the tolerance it states."""

import json
import math
import subprocess
import sys

import pytest

from reconstruction.rendering.gsplat_backend import why_unavailable
from reconstruction.stability.case import Case, row_of
from reconstruction.stability.catalogue import CASES
from reconstruction.stability.probe import backends

MISSING = why_unavailable()
BACKENDS = (
    "reference",
    "native",
    pytest.param("gsplat", marks=[pytest.mark.gpu, pytest.mark.skipif(MISSING is not None, reason=str(MISSING))]),
)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("case", [c for c in CASES if c.renders], ids=lambda c: f"{c.number:02d} {c.name}")
def test_a_case_is_rendered_as_expected(case, backend):
    row = row_of(case, backend)
    assert row.verdict == "pass", row


@pytest.mark.parametrize("case", [c for c in CASES if not c.renders], ids=lambda c: f"{c.number:02d} {c.name}")
def test_a_case_without_a_rendering_is_as_expected(case):
    row = row_of(case, "native")
    assert row.verdict == "pass", row
    assert row.backend == "none"


def test_what_is_too_far_off_or_throws_fails():
    def thrown(_):
        raise ValueError("no such thing")

    verdicts = []
    for observe in (lambda _: ("near", 0.1), lambda _: ("far", 0.2), lambda _: ("NaN", math.nan), thrown):
        verdicts.append(row_of(Case(0, "made up", "near", 0.1, observe), "native").verdict)
    assert verdicts == ["pass", "fail", "fail", "fail"]


@pytest.mark.slow
def test_the_command_prints_one_document():
    command = [sys.executable, "-m", "server.cli", "stability", "--json"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    document = json.loads(result.stdout)
    rows = document["rows"]
    assert all({"case", "backend", "expected", "observed", "error", "verdict"} == set(row) for row in rows)
    assert {row["backend"] for row in rows} == {*backends(), "none"}
    failed = sum(row["verdict"] == "fail" for row in rows)
    assert document["summary"] == {"cases": len(rows), "failed": failed}
    assert result.returncode == (1 if failed else 0)
