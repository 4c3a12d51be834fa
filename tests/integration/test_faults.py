"""A small campaign of faults: jobs and real captures while parts of the service are killed, and nothing is lost."""

from pathlib import Path

import pytest
from maintenance.campaign import Plan
from maintenance.faults import faults_of, run_campaign
from maintenance.postgresql import PostgresqlMissingError

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "database", ["sqlite", pytest.param("postgres", marks=[pytest.mark.postgres, pytest.mark.long])]
)
def test_a_campaign_loses_doubles_and_overstates_nothing(tmp_path: Path, database: str) -> None:
    try:
        row = run_campaign(tmp_path, Plan(kills=8, jobs=3, captures=8), database, seed=5, limit_s=400)
    except PostgresqlMissingError as error:
        pytest.skip(str(error))
    counts = row["counts"]
    assert (faults_of(counts), row["at_fault"]) == ({}, [])
    assert counts["kills"] >= 8  # two may fall together
    assert (counts["jobs"], counts["captures.captures"]) == (3, 8)
    assert counts["kills.recorder"] + counts["kills.worker_at_capture"] > 0
