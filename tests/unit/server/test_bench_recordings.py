"""The recordings that benches share."""

import pytest

from acquisition.errors import AcquisitionError
from server.cli.bench_asked import recording


def test_a_recording_that_is_there_is_not_made_again(tmp_path):
    (tmp_path / "fan-101").mkdir()
    assert recording("fan", 101, tmp_path) == tmp_path / "fan-101"


def test_a_simulation_that_fails_is_said_in_one_line(tmp_path):
    with pytest.raises(AcquisitionError, match=r"^nowhere-1: found that simulate failed"):
        recording("nowhere", 1, tmp_path)
    assert not list(tmp_path.iterdir())
