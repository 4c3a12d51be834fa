"""A service under many clients: nobody is refused or forgotten while a stage burns a core."""

from pathlib import Path

import pytest

from server.bench.load import run_load, summarise


def test_figures_of_known_answers() -> None:
    answers = [("job", 200, n / 1e3) for n in range(1, 101)] + [("sse", 500, 0.2), ("event", 200, 0.1)]
    rows, summary = summarise(answers)
    assert rows[1] == {"kind": "job", "number": 100, "p50_ms": 51.0, "p95_ms": 96.0, "p99_ms": 100.0, "most_ms": 100.0}
    assert [row["kind"] for row in rows] == ["event", "job", "sse"]
    assert (summary["requests"], summary["events"]) == (101, 1)
    assert (summary["answers.200"], summary["answers.500"]) == (100, 1)


@pytest.mark.slow
def test_twenty_clients_are_answered(tmp_path: Path) -> None:
    document = run_load(tmp_path / "data", clients=20, seconds=5.0, jobs=30, step_s=0.02)
    answers = {name: number for name, number in document.summary.items() if name.startswith("answers.")}
    assert set(answers) == {"answers.200"}, answers
    assert {row["kind"] for row in document.rows} == {"listing", "job", "download", "sse", "stream", "event"}
    assert answers["answers.200"] == document.summary["requests"]
