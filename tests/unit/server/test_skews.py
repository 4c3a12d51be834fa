"""Warnings of planes that are not of one instant."""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from acquisition.errors import IncompleteError
from acquisition.recording.manifest import CameraFile, Manifest
from acquisition.spikes.layout import PlaneLayout
from server.cli import acquire
from server.cli.skews import skew_doubt


def recorded(**skews_s: float | None) -> Manifest:
    entry = CameraFile("cam00", "cam00.dat", PlaneLayout(8, 8), 0, 0, 80, (), None)
    cameras = (replace(entry, id=name, file=f"{name}.dat", skew_s=skew_s) for name, skew_s in skews_s.items())
    return Manifest(20_000.0, "box", "spike4dgs", "", tuple(cameras))


def test_planes_more_than_one_apart_are_told_and_others_are_not() -> None:
    found = skew_doubt(recorded(cam00=-0.5e-3, cam01=0.0, cam02=2.53e-3, cam10=None))
    assert found is not None
    assert found.startswith("planes of cam02 come 60.6 planes after those of cam00 with the same number")
    for quiet in (recorded(cam00=-25e-6, cam01=25e-6), recorded(cam00=None, cam01=None), recorded(cam00=1.0)):
        assert skew_doubt(quiet) is None


def test_a_recording_that_was_cut_short_is_warned_of_as_well(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def record(*_: object) -> Manifest:
        raise IncompleteError("it was stopped")

    monkeypatch.setattr(acquire, "record", record)
    monkeypatch.setattr(acquire, "read_manifest", lambda path: recorded(cam00=0.0, cam01=1e-3))
    arguments = ["--rig", "ci3x3", "--ticks", "100", "--out", str(tmp_path / "rec")]
    found = CliRunner().invoke(acquire.record_command, arguments)
    assert isinstance(found.exception, IncompleteError)
    assert "planes of cam01 come 20 planes after those of cam00" in found.output
