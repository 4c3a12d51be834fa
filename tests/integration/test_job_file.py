"""The same jobs on SQLite and on PostgreSQL, with two workers and the real stages: the same results to the bit."""

import json
import sys
from functools import partial
from pathlib import Path

import httpx
import pytest
from maintenance.deployment import Deployment
from maintenance.postgresql import PostgresqlMissingError
from maintenance.waiting import wait_for

from server.client import RefusedError, ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import BatchRequest, ExportRequest

pytestmark = [pytest.mark.slow, pytest.mark.long, pytest.mark.postgres]
STAGE = (sys.executable, "-P", "-m", "server.cli")
ENVIRONMENT = {"SPIKE4DGS_RIGS": json.dumps({"ci3x3": {"rig": "ci3x3", "devices": "mock:static?seed=3"}})}
SAME = ("metrics.json", "viewer.json", "viewer.bin")
RUN = {"type": "reconstruct", "holdout": "cam11", "steps": 60}
patiently = partial(wait_for, limit_s=600.0)


def ready(client: ServiceClient) -> bool:
    try:
        return len(client.workers()) == 2
    except (httpx.TransportError, RefusedError):
        return False


def ended(client: ServiceClient, job_id: str) -> bool:
    job = client.job(job_id)
    assert job.status != "failed", job.error
    return job.status == "done"


def results(deployment: Deployment) -> dict[str, str]:
    """SHA-256 of what must not depend on the database or the worker, by the job's name and the artefact's."""
    for name in ("api", "a", "b"):
        deployment.start(name)
    with ServiceClient.at(deployment.address) as client:
        patiently(lambda: ready(client))
        capture = client.start_capture("ci3x3", CaptureRequest(ticks=64)).id
        patiently(lambda: client.capture(capture).status == "done")
        jobs = [RUN | {"capture": capture, "seed": seed, "name": f"seed {seed}"} for seed in range(3)]
        jobs.append({"type": "verify", "capture": capture, "name": "verify"})
        queued = client.submit_all(BatchRequest.model_validate({"jobs": jobs}).jobs)
        patiently(lambda: all(ended(client, job.id) for job in queued))
        export = ExportRequest(type="export", job=queued[0].id, format="ply", name="export")
        queued.append(client.submit(export))
        patiently(lambda: ended(client, queued[-1].id))
        assert deployment.dead() == []
        assert json.loads(client.artefact(queued[3].id, "result.json"))["sound"] is True
        found = {(job.name, one.name): one.sha256 for job in queued for one in client.artefacts(job.id)}
    return {f"{job}: {name}": sha for (job, name), sha in found.items() if name in SAME or name.endswith(".ply")}


def test_the_database_changes_nothing(tmp_path: Path) -> None:
    found = {}
    for database in ("sqlite", "postgresql"):
        try:
            deployment = Deployment(
                tmp_path / database,
                postgresql=database == "postgresql",
                dead_s=15.0,
                stage=STAGE,
                environment=ENVIRONMENT,
            )
        except PostgresqlMissingError as error:
            pytest.skip(str(error))
        try:
            found[database] = results(deployment)
        finally:
            deployment.close()
    assert len(found["sqlite"]) == 3 * len(SAME) + 1
    assert found["sqlite"] == found["postgresql"]
    assert len(set(found["sqlite"].values())) == len(found["sqlite"])  # each seed has results of its own
