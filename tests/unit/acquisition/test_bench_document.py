"""Tests the part of a bench document that describes the machine."""

import pytest

from acquisition.bench_document import Stolen


def test_what_other_guests_took_is_a_share_of_all_time(tmp_path):
    source = tmp_path / "stat"
    source.write_text("cpu  100 0 50 800 0 0 0 10 0 0\ncpu0 1 2 3\n")
    others = Stolen(source)
    assert others.share() == 0
    source.write_text("cpu  160 0 60 810 0 0 0 30 0 0\ncpu0 1 2 3\n")
    assert others.share() == pytest.approx(20 / 100)


def test_a_system_that_does_not_tell_has_none(tmp_path):
    assert Stolen(tmp_path / "none").share() == 0
