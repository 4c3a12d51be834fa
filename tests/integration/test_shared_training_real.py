"""A long recording that two workers reconstruct together, one of which is killed: the scene is that of one process."""

import json
import sys
from pathlib import Path

import httpx
import pytest
import torch
from maintenance.deployment import Deployment, ancestors
from maintenance.waiting import wait_for

from acquisition.progress import silent
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.parts import PartFolder
from reconstruction.training.checkpoint import load_cloud
from server.client import RefusedError, ServiceClient
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest

pytestmark = pytest.mark.slow
REAL = (sys.executable, "-P", "-m", "server.cli")
RIGS = {"SPIKE4DGS_RIGS": json.dumps({"small": {"rig": "ci3x3", "devices": "mock:fan_and_ball?truth_every=1000"}})}
CHOICES = {"holdout": "cam11", "steps": 24, "seed": 1, "span": 100}


def test_the_scene_is_the_same_to_the_bit(tmp_path: Path) -> None:
    deployment = Deployment(tmp_path / "data", postgresql=False, dead_s=3.0, stage=REAL, environment=RIGS)
    try:
        for name in ("api", "a", "b"):
            deployment.start(name)
        with ServiceClient.at(deployment.address) as client:
            wait_for(lambda: is_up(client))
            capture = client.start_capture("small", CaptureRequest(ticks=300)).id
            wait_for(lambda: client.capture(capture).status == "done")
            job = client.submit(ReconstructRequest.model_validate({"capture": capture, **CHOICES})).id
            run = deployment.data / "jobs" / job / "run"
            worker = deployment.processes["b"].pid
            wait_for(lambda: learns(worker, run), limit_s=400)
            deployment.kill("b")
            wait_for(lambda: client.job(job).status not in ("queued", "running"), limit_s=400)
            assert (client.job(job).status, client.job(job).warnings) == ("done", [])
            assert {step.status for step in client.steps(job)} == {"done"}
            assert client.job_preview(job)[:4] == b"\x89PNG"
            assert {"metrics.json", "report.html"} <= {one.name for one in client.artefacts(job)}
        alone = reconstruct(
            deployment.data / "captures" / capture,
            tmp_path / "alone",
            ReconstructionConfig(budget_s=None, **CHOICES),
            lambda stage: silent,
            last="train",
        )
        mine, others = (load_cloud(path / "checkpoint.pt").tensors() for path in (alone.path, run))
        for (name, a), (_, b) in zip(mine, others, strict=True):
            assert torch.equal(a, b), name
    finally:
        deployment.close()


def is_up(client: ServiceClient) -> bool:
    try:
        return {one.id for one in client.workers()} == {"a", "b"}
    except (RefusedError, httpx.TransportError):
        return False


def learns(worker: int, run: Path) -> bool:
    """Return whether a process below that of a worker learns a span now: it holds the span's lock."""
    learnt = PartFolder(run).there()
    files = {file.stat().st_ino for file in (run / "spans").glob("0*.lock") if file.stem not in learnt}
    locks = [line.split() for line in Path("/proc/locks").read_text().splitlines() if "->" not in line]  # those held
    pids = [int(lock[4]) for lock in locks if int(lock[5].rpartition(":")[2]) in files]
    return any(worker in ancestors(pid) for pid in pids)
