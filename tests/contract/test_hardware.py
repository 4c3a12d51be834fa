"""Tests a connected rig (L3), named by SPIKE4DGS_RIG as a RIG.toml. Nobody has run them yet."""

import os
import threading
from pathlib import Path

import pytest

from acquisition.devices.open import open_cameras
from acquisition.devices.registers import LinkCounters, Sensitivity
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from acquisition.session.preflight import Surroundings, preflight
from acquisition.session.record import Take, record
from rigs.rig import Rig
from rigs.toml import load_rig

pytestmark = pytest.mark.hardware
SECONDS = 5.0


@pytest.fixture(scope="module")
def rig() -> Rig:
    path = os.environ.get("SPIKE4DGS_RIG")
    if not path:
        pytest.skip("no cameras: set SPIKE4DGS_RIG to the RIG.toml of a connected rig")
    return load_rig(Path(path))


def test_the_pre_flight_passes(rig, tmp_path):
    checks = preflight(rig, Surroundings(lambda cameras: open_cameras(cameras, None, 0), tmp_path))
    assert [str(check) for check in checks if check.passed is False] == []


def test_every_camera_answers_beside_its_stream(rig):
    with open_cameras(rig, None, 0) as opened:
        for camera in opened.cameras:
            first, last = camera.registers.latch(), camera.registers.latch()
            assert last.oscillator_s > first.oscillator_s, camera.id
            assert first.uncertainty_s < 1e-2, camera.id
            camera.registers.set_sensitivity(camera.registers.read(Sensitivity))
            camera.registers.read(LinkCounters)


def test_a_reset_by_the_host_brings_every_camera_back(rig):
    with open_cameras(rig, None, 0) as opened:
        for camera in opened.cameras:
            camera.reset()
            threading.Event().wait(2.0)  # to enumerate anew
            camera.reopen()
            camera.ensure_ready()
            camera.ensure_stopped()


def test_a_run_at_full_rate_loses_nothing_and_its_clocks_agree(rig, tmp_path):
    planes = round(SECONDS * rig.tick_rate_hz)
    manifest = record(rig, "usb:", Take(planes, rejoin_s=0.0), tmp_path / "rec")
    assert verify(tmp_path / "rec") == []
    assert {camera.planes for camera in manifest.cameras} == {planes}
    for camera in Recording.open(tmp_path / "rec").manifest.cameras:
        assert sum(camera.drops.values()) == 0, camera.id
        assert camera.device is not None
        assert camera.device["link"] == {"errors": 0, "recoveries": 0, "overruns": 0}, camera.id
        assert camera.skew_s is None or abs(camera.skew_s) < 1 / rig.tick_rate_hz, camera.id
