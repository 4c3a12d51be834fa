"""A rig that was not built as drawn, through the real service: recorded, calibrated, recorded and checked again."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from maintenance.waiting import wait_for

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from reconstruction.metrics.poses import pose_errors
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.truth import Truth
from rigs.rig import object_distance_m
from server.app import create_app
from server.client import ServiceClient
from server.schemas.calibrations import CalibrationRequest
from server.schemas.captures import CaptureRequest
from server.settings import RigSource, ServiceSettings

pytestmark = pytest.mark.slow
DEVICES = "mock:fan_and_ball?seed=3&rig_error=2&truth_every=60"
patiently = partial(wait_for, limit_s=600.0)


def rotation_error_deg(recording: Recording) -> float:
    assert recording.truth is not None
    true = Truth.open(recording.truth).cameras(recording.tick_rate_hz)
    assert true is not None
    true = true.only(recording.camera_ids)
    return pose_errors(recording.rig, true, object_distance_m(true.cameras)).rotation_deg


def test_a_calibration_serves_the_captures_after_it(tmp_path: Path) -> None:
    pytest.importorskip("cv2", reason="features are OpenCV's", exc_type=ImportError)
    data, source = tmp_path / "data", {"lab3x3": RigSource(rig="lab3x3", devices=DEVICES)}
    command = [sys.executable, "-m", "server.cli", "worker", "--data", str(data), "--rig", "lab3x3"]
    with TestClient(create_app(ServiceSettings(data=data, rigs=source)), base_url="http://127.0.0.1") as http:
        client = ServiceClient(http)
        worker = subprocess.Popen([*command, "--devices", DEVICES], env=os.environ)
        try:
            calibrating = client.calibrate("lab3x3", CalibrationRequest(ticks=120))
            patiently(lambda: client.job(calibrating.id).status in ("done", "failed"))
            assert client.job(calibrating.id).error is None
            (first,) = client.captures()
            second = client.start_capture("lab3x3", CaptureRequest(ticks=120))
            patiently(lambda: client.capture(second.id).status in ("done", "failed"))
            check = client.check_calibration("lab3x3", second.id)
            patiently(lambda: client.job(check.id).status in ("done", "failed"))
        finally:
            worker.terminate()
            worker.wait(30)
        assert json.loads(client.artefact(check.id, "result.json"))["fits"]
        now = client.current_calibration("lab3x3")
        assert (now.version, now.source, now.picture) == (1, "natural", True)
        assert len(now.cameras) == 9
    before, after = (Recording.open(data / "captures" / capture.id) for capture in (first, second))
    assert before.rig.poses == "nominal"
    assert rotation_error_deg(before) > 1
    assert after.rig.calibration is not None
    assert rotation_error_deg(after) < 0.03  # the cameras stand where they stood: the rig file now says where
    config = replace(
        ReconstructionConfig(holdout="cam11", steps=40, budget_s=None, seed=1, gaussians=2000), init="auto"
    )
    run = reconstruct(after.path, tmp_path / "run", config, lambda stage: silent, last="poses")
    (decision,) = (decision for decision in run.plan.decisions if decision.about == "poses")
    assert (decision.choice, decision.reason) == ("not estimated", "the rig's poses are calibrated")
    assert run.document.poses is None
