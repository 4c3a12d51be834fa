"""Tests that a power cut costs a recording its last second, and that a disk that refuses to flush is told."""

import errno
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from acquisition.recording.finalise import finalise
from acquisition.recording.flusher import EVERY_S, Flusher
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.toml import catalog_rig

LAYOUT = PlaneLayout(40, 25)
RIG = catalog_rig("ci3x3").scaled(40, 25)
ROUNDS = 3  # of flushing, before the lights go out


@pytest.fixture
def platter(tmp_path, monkeypatch):
    """Return a folder with the files as they were when they were flushed last: what a power cut leaves."""
    kept = tmp_path / "platter" / "rec.partial"
    kept.mkdir(parents=True)

    def keep(handle: int) -> None:
        path = Path(f"/proc/self/fd/{handle}").readlink()
        name = "recording.json" if "recording.json" in path.name else path.name  # flushed before it gets its name
        if path.is_file() and path.parent.name == "rec.partial":
            shutil.copyfile(path, kept / name)

    monkeypatch.setattr(os, "fdatasync", keep)
    monkeypatch.setattr(os, "fsync", keep)
    return kept


def test_a_power_cut_costs_what_came_after_the_last_whole_round_began(platter, tmp_path) -> None:
    block = np.full((200, LAYOUT.plane_bytes), 0x55, np.uint8)
    taken = {}
    with RecordingWriter(tmp_path / "rec", RIG) as recording:
        streams = [recording.stream(camera_id, LAYOUT) for camera_id in RIG.ids]
        recording.mark("recording", "software")
        while (rounds := recording._flusher.rounds) < ROUNDS:
            for stream in streams:
                stream.append(block)
            time.sleep(0.01)
            taken[recording._flusher.rounds] = streams[0].planes
        shutil.copytree(platter, tmp_path / "after.partial")
    assert rounds == ROUNDS
    found = finalise(tmp_path / "after")
    flushed = taken[ROUNDS - 2]  # before the last but one round ended, so before the last began
    assert all(camera.planes >= flushed - streams[0].block_planes for camera in found.manifest.cameras)
    assert found.manifest.status == "incomplete"


def test_there_is_a_round_every_second() -> None:
    assert EVERY_S == 1.0


def test_a_disk_that_refuses_to_flush_is_told(tmp_path, monkeypatch) -> None:
    def refuse(handle: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    (tmp_path / "a.dat").write_bytes(b"1")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", refuse)
        with Flusher(tmp_path, "*.dat", every_s=0.01) as flusher:
            time.sleep(0.2)
    assert flusher.failure is not None
    assert flusher.failure.errno == errno.EIO


def test_files_may_come_and_go(tmp_path) -> None:
    with Flusher(tmp_path, "*", every_s=0.0) as flusher:
        for number in range(300):
            (tmp_path / str(number)).write_bytes(b"1")
            (tmp_path / str(number)).unlink()
    assert flusher.failure is None
    assert flusher.rounds > 0
