"""Tests that rounds of faults are written as they end, gone on with, and kept where they found something."""

import json
from pathlib import Path

import pytest
from maintenance import faults
from maintenance.campaign import Plan
from maintenance.faults import Rounds, is_at_fault

PLAN = Plan(1, 1, 1)


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[str, int]]:
    """The rounds that were run; the third seed is broken."""
    rounds: list[tuple[str, int]] = []

    def run(folder: Path, plan: Plan, database: str, seed: int) -> dict:
        (folder / "data").mkdir()
        rounds.append((database, seed))
        counts = {"kills": 50.0, "lost": 0.0, "broken": float(seed == 3)}
        return {"database": database, "seed": seed, "counts": counts, "at_fault": ["why"] if seed == 3 else []}

    monkeypatch.setattr(faults, "run_campaign", run)
    monkeypatch.setattr(faults, "code_revision", lambda: "abc")
    monkeypatch.setattr(faults.tempfile, "tempdir", str(tmp_path))
    return rounds


def test_each_round_is_written_as_it_ends_and_not_run_again(ran: list, tmp_path: Path) -> None:
    out = tmp_path / "faults.json"
    for number in (1, 2):
        Rounds(out).run("sqlite", number, PLAN)
        document = json.loads(out.read_text())
        assert [row["seed"] for row in document["rows"]] == list(range(1, number + 1))
        assert document["summary"]["sqlite.kills"] == 50 * number
    again = Rounds(out)
    assert again.missing("sqlite", range(1, 5)) == [3, 4]
    assert again.missing("postgres", range(1, 3)) == [1, 2]
    assert [path.name for path in tmp_path.iterdir()] == ["faults.json"]


def test_rounds_of_other_code_do_not_count(ran: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "faults.json"
    Rounds(out).run("sqlite", 1, PLAN)
    monkeypatch.setattr(faults, "code_revision", lambda: "abc-dirty")  # the document itself has changed
    assert Rounds(out).missing("sqlite", range(1, 3)) == [2]
    monkeypatch.setattr(faults, "code_revision", lambda: "def")
    assert Rounds(out).missing("sqlite", range(1, 3)) == [1, 2]


def test_a_round_with_a_fault_is_counted_and_what_it_left_is_kept(ran: list, tmp_path: Path) -> None:
    out = tmp_path / "faults.json"
    Rounds(out).run("sqlite", 3, PLAN)
    document = json.loads(out.read_text())
    assert document["summary"]["sqlite.broken"] == 1
    assert document["omissions"] == ["sqlite round 3: why"]
    assert (Path(document["rows"][0]["kept"]) / "data").is_dir()
    assert Rounds(out).missing("sqlite", range(3, 4)) == []


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        ({"faults": []}, False),
        ({"faults": ["torn"]}, True),
        ({"status": "done", "missing": 0, "repeated": 0, "reopened": 0, "torn": []}, False),
        ({"status": "lost", "missing": 0, "repeated": 0, "reopened": 0, "torn": []}, True),
        ({"status": "done", "missing": 0, "repeated": 1, "reopened": 0, "torn": []}, True),
        ({"status": "done", "missing": 0, "repeated": 0, "reopened": 0, "torn": ["x"]}, True),
    ],
)
def test_what_is_at_fault(row: dict, *, expected: bool) -> None:
    assert is_at_fault(row) is expected
