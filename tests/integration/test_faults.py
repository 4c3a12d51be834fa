"""A small campaign of faults: jobs and real captures while parts of the service are killed, and nothing is lost."""

from pathlib import Path

import pytest
from maintenance.campaign import Plan
from maintenance.faults import faults_of, run_campaign
from maintenance.postgresql import PostgresqlMissingError

pytestmark = pytest.mark.slow
PLAN = Plan(kills=5, jobs=2, captures=5)  # `make faults` has rounds of 50, 15 and 30


@pytest.mark.parametrize(
    "database", ["sqlite", pytest.param("postgres", marks=[pytest.mark.postgres, pytest.mark.long])]
)
def test_a_campaign_loses_doubles_and_overstates_nothing(tmp_path: Path, database: str) -> None:
    try:
        row = run_campaign(tmp_path, PLAN, database, seed=5, limit_s=400)
    except PostgresqlMissingError as error:
        pytest.skip(str(error))
    counts = row["counts"]
    assert (faults_of(counts), row["at_fault"]) == ({}, [])
    assert counts["kills"] >= PLAN.kills  # two may fall together
    assert (counts["jobs"], counts["captures.captures"]) == (PLAN.jobs, PLAN.captures)
    assert counts["kills.recorder"] + counts["kills.worker_at_capture"] > 0
