"""The stress catalogue on everything this machine has: each case within the tolerance it states."""

import json
import math
import subprocess
import sys

import pytest

from acquisition.errors import AcquisitionError
from acquisition.native import code_path, code_paths, load_library
from reconstruction.rendering.gsplat_backend import why_unavailable
from reconstruction.stability.case import Case, Observation, row_of
from reconstruction.stability.catalogue import CASES
from reconstruction.stability.probe import BUILDS, omissions, renderers

MISSING = why_unavailable()
GPU = [pytest.mark.gpu, pytest.mark.skipif(MISSING is not None, reason=str(MISSING))]
PAIRS = [(case, name) for case in CASES for name in case.on() if name != "gsplat"]


def named(value):
    return f"{value.number or 0:02d} {value.name}" if isinstance(value, Case) else value.replace(" ", "-")


@pytest.mark.parametrize(("case", "backend"), PAIRS, ids=named)
def test_a_case_is_as_expected(case, backend):
    row = row_of(case, backend)
    assert row.verdict == "pass", row


@pytest.mark.parametrize("case", [case for case in CASES if case.on is renderers], ids=named)
@pytest.mark.parametrize("backend", [pytest.param("gsplat", marks=GPU)])
def test_a_case_is_as_expected_of_gsplat(case, backend):
    row = row_of(case, backend)
    assert row.verdict == "pass", row


def test_every_case_of_the_catalogue_is_there():
    assert {case.number for case in CASES} == {*range(1, 32), None}  # None: of radiance fields and of spans


def test_what_is_too_far_off_or_throws_fails():
    def thrown(_):
        raise ValueError("no such thing")

    found = (("near", 0.1), ("far", 0.2), ("NaN", math.nan), ("near", 0.1, 1.0), ("steep", 0.0, 1.1))
    looks = [lambda _, seen=seen: Observation(*seen) for seen in found]
    rows = [row_of(Case(0, "made up", "near", 0.1, observe), "none") for observe in (*looks, thrown)]
    assert [row.verdict for row in rows] == ["pass", "fail", "fail", "pass", "fail", "fail"]
    assert [row.error for row in rows] == [0.1, 0.2, None, 0.1, 0.0, None]


def test_each_code_path_has_kernels_of_its_own():
    best = load_library("reconstruction")._name
    for name in code_paths():
        with code_path(name):
            assert load_library("reconstruction")._name.endswith(f"-{name}.so")
    assert load_library("reconstruction")._name == best
    with pytest.raises(AcquisitionError, match="found the code path v9"), code_path("v9"):
        pass


def test_what_this_machine_lacks_is_said():
    lacking = [] if "plain" in code_paths() else [name for name in BUILDS if name not in code_paths()]
    assert [line.split(":")[0] for line in omissions()] == [
        *(f"native {n}" for n in lacking),
        *["gsplat"] * bool(MISSING),
    ]


@pytest.mark.slow
def test_the_command_prints_one_document():
    command = [sys.executable, "-m", "server.cli", "stability", "--json"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    document = json.loads(result.stdout)
    rows = document["rows"]
    fields = {"case", "backend", "expected", "observed", "error", "gradient", "verdict"}
    assert all(fields == set(row) for row in rows)
    assert {row["backend"] for row in rows} == {name for case in CASES for name in case.on()}
    failed = sum(row["verdict"] == "fail" for row in rows)
    assert document["summary"] == {"cases": len(rows), "failed": failed}
    assert result.returncode == (1 if failed else 0)
