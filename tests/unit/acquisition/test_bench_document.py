"""Tests the parts of a bench document that describe the machine and the revision."""

import pytest

from acquisition.bench_document import Stolen, machines_of, revisions_of


def test_what_other_guests_took_is_a_share_of_all_time(tmp_path):
    source = tmp_path / "stat"
    source.write_text("cpu  100 0 50 800 0 0 0 10 0 0\ncpu0 1 2 3\n")
    others = Stolen(source)
    assert others.share() == 0
    source.write_text("cpu  160 0 60 810 0 0 0 30 0 0\ncpu0 1 2 3\n")
    assert others.share() == pytest.approx(20 / 100)


def test_a_system_that_does_not_tell_has_none(tmp_path):
    assert Stolen(tmp_path / "none").share() == 0


DOCUMENT = {"device": {"processor": "new chip", "threads": 2}, "revision": "new"}
OLDER = {"processor": "old chip", "threads": 4, "revision": "old"}


def test_rows_name_their_own_machine_and_revision_and_other_rows_the_documents():
    assert machines_of(DOCUMENT, [OLDER]) == "old chip, 4 threads"
    assert revisions_of(DOCUMENT, [OLDER]) == "revision old"
    newer = OLDER | DOCUMENT["device"] | {"revision": "new"}
    assert machines_of(DOCUMENT, [OLDER, newer]) == "new chip, 2 threads; old chip, 4 threads"
    assert revisions_of(DOCUMENT, [OLDER, newer]) == "revisions new, old"
    for rows in ([], [{"revision": "of a rival", "which": "old"}], [{"psnr_db": 30.0}]):
        assert machines_of(DOCUMENT, rows) == "new chip, 2 threads"
        assert revisions_of(DOCUMENT, rows) == "revision new"
