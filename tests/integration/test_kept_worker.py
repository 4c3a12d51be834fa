"""Tests that a worker which ends is started again, that this is said, and that it is given up when nothing helps."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import httpx
import psutil
import pytest
from maintenance.waiting import wait_for

from server.work.keeper import Keeper


def keeper_of(tmp_path: Path, program: str, pause_s: float = 0.01) -> Keeper:
    """Return a keeper of a program that knows its folder as `here`."""
    said = f"import pathlib, sys, time; here = pathlib.Path({str(tmp_path)!r}); {program}"
    return Keeper([sys.executable, "-c", said], grace_s=5, pause_s=pause_s)


COUNT = "(here / str(time.monotonic_ns())).touch()"


def test_it_is_started_again_and_stopped_at_the_end(tmp_path) -> None:
    with keeper_of(tmp_path, f"{COUNT}; time.sleep(0 if len(list(here.iterdir())) < 3 else 60)").running():
        wait_for(lambda: len(list(tmp_path.iterdir())) == 3)
        time.sleep(0.3)
    assert len(list(tmp_path.iterdir())) == 3


def test_its_end_is_told_and_it_is_given_up_loudly(tmp_path, caplog) -> None:
    keeper = keeper_of(tmp_path, f"{COUNT}; sys.exit(3)")
    with keeper.running():
        wait_for(lambda: keeper.given_up)
    assert len(list(tmp_path.iterdir())) == 8
    assert keeper.trouble is not None
    assert "ended 8 times" in keeper.trouble
    assert "ended with exit code 3; it starts again in 0.02 s" in caplog.text
    assert [record.levelname for record in caplog.records].count("ERROR") == 1


def test_a_pause_is_cut_short_by_the_end(tmp_path) -> None:
    keeper = keeper_of(tmp_path, "sys.exit(3)", pause_s=1000)
    with keeper.running():
        wait_for(lambda: keeper.trouble is not None)
    assert not keeper.given_up


@pytest.mark.slow
def test_a_service_starts_its_killed_worker_again_and_says_so(tmp_path) -> None:
    flags = ["--port", "0", "--data", str(tmp_path), "--devices", "mock:fan_and_ball", "--with-worker"]
    command = [sys.executable, "-m", "server.cli", "serve", *flags]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as service:
        assert service.stdout is not None
        http = httpx.Client(base_url=service.stdout.readline().decode().strip(), trust_env=False)
        try:
            wait_for(lambda: http.get("/v1/readyz").status_code == 200)
            (worker,) = psutil.Process(service.pid).children()
            worker.kill()
            wait_for(lambda: http.get("/v1/readyz").status_code == 503)
            assert "the worker ended with SIGKILL; it starts again" in json.dumps(http.get("/v1/readyz").json())
            wait_for(lambda: http.get("/v1/readyz").status_code == 200)
        finally:
            http.close()
            service.terminate()
        _, said = service.communicate(timeout=60)
    assert b"the worker ended with SIGKILL" in said


@pytest.mark.slow
def test_a_service_without_a_rig_has_a_worker_for_all_else(tmp_path) -> None:
    command = [sys.executable, "-m", "server.cli", "serve", "--port", "0", "--data", str(tmp_path), "--with-worker"]
    without = os.environ | {"SPIKE4DGS_RIGS": "{}"}
    with subprocess.Popen(command, env=without, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as service:
        assert service.stdout is not None
        http = httpx.Client(base_url=service.stdout.readline().decode().strip(), trust_env=False)
        try:
            wait_for(lambda: http.get("/v1/readyz").status_code == 200)
            (worker,) = http.get("/v1/workers").json()["items"]
        finally:
            http.close()
            service.terminate()
        _, said = service.communicate(timeout=60)
    assert worker["queues"] == ["reconstructions", "tasks"]
    assert b"waits for the service to name its rigs; it serves reconstructions, tasks meanwhile" in said
