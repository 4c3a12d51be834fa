"""The bench of MSDI's trainings: its arms, that it resumes, and its page."""

from dataclasses import replace
from typing import ClassVar

import pytest

from acquisition.bench_document import device
from acquisition.progress import silent
from acquisition.revision import code_revision
from reconstruction.bench import msdi
from reconstruction.bench.msdi import ARMS, SCORES, SHIPPED_ARM, bench_msdi, write_page
from reconstruction.metrics.poses import pose_errors
from reconstruction.networks.training import msdi_validation
from reconstruction.networks.training.clips import MultiviewClips
from reconstruction.networks.training.msdi_validation import RANDOM_ERROR, ScoredViews
from rigs.toml import catalog_rig

SMALL = MultiviewClips(910_007, 1, 3, 56, 40)


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A folder to train in, with small clips to score on."""
    monkeypatch.setattr(msdi_validation, "random_clips", lambda kinds, count: SMALL)
    return tmp_path / "work"


def test_every_arm_is_trained_once_and_scored_beside_what_ships(work, tmp_path, monkeypatch):
    document = bench_msdi([], work, silent, quick=True)
    assert [row["arm"] for row in document.rows] == [*ARMS, SHIPPED_ARM]
    assert all(row["scene"] == "clutter" and row.keys() >= SCORES.keys() for row in document.rows)
    assert [row.get("steps") for row in document.rows] == [2, 2, 2, None]
    for row in document.rows:
        assert document.summary[f"{row['arm']}.clutter.abs_rel"] == row["abs_rel"]
    trained = [row["abs_rel"] for row in document.rows]
    assert trained[0] != trained[3]
    write_page(tmp_path / "msdi.md", document.to_json())
    text = (tmp_path / "msdi.md").read_text()
    assert all(f"| {arm} | clutter |" in text for arm in (*ARMS, SHIPPED_ARM))

    monkeypatch.setattr(msdi, "MsdiTraining", None)  # nothing is trained again
    assert bench_msdi([], work, silent, quick=True).to_json()["rows"] == document.to_json()["rows"]


def test_recordings_start_from_a_misplaced_rig_as_random_clips_do():
    rig, clip = catalog_rig("ci3x3"), SMALL.make(SMALL.first_seed)
    known = {part: ScoredViews(part, "some", clip, rig) for part in ("random", "development")}
    found = {part: msdi.misplaced_views(one, 5).nominal for part, one in known.items()}
    assert found["random"] is rig
    off = pose_errors(found["development"], rig, 1.0)
    assert 0.5 * RANDOM_ERROR < off.rotation_deg < 2 * RANDOM_ERROR
    assert abs(off.focal_percent - RANDOM_ERROR) < 0.1
    assert msdi.misplaced_views(known["development"], 6).nominal != found["development"]


@pytest.fixture
def told(monkeypatch):
    """The folders and configurations of the trainings that are asked for, none of which is done."""
    asked = []

    class Told:
        curve: ClassVar = [{"step": 2, "seconds": 1.0, **{f"clutter {score}": 1.0 for score in SCORES}}]

        def __init__(self, folder, config, clips, device, notes):
            assert clips.name.rpartition("-")[2] == folder.name.rpartition("-")[2]  # the same code's
            asked.append((folder.name, config))

        def run(self, score, progress):
            pass

    monkeypatch.setattr(msdi, "MsdiTraining", Told)
    return asked


def test_arms_differ_in_what_they_are_called_after_and_in_nothing_else(work, told):
    bench_msdi([], work, silent, quick=True)
    configs = [config for _, config in told]
    assert [(config.joint, config.pretrained) for config in configs] == [(True, True), (False, True), (True, False)]
    assert len({replace(config, joint=True, pretrained=True) for config in configs}) == 1


def test_other_networks_are_trained_anew_and_rows_tell_their_code(work, told, monkeypatch):
    for code in ("one", "one", "two"):
        monkeypatch.setattr(msdi, "networks_code", lambda: code)  # noqa: B023 - called within its turn
        document = bench_msdi([], work, silent, quick=True)
    assert [name.rpartition("-")[2] for name, _ in told] == ["one"] * len(ARMS) + ["two"] * len(ARMS)
    about = device() | {"revision": code_revision()}
    assert all(row.items() >= about.items() for row in document.rows if row["arm"] != SHIPPED_ARM)


def test_without_time_the_table_is_not_printed(work, tmp_path):
    document = bench_msdi([], work, silent, quick=True, time_left=lambda: False).to_json()
    assert [row["arm"] for row in document["rows"]] == [SHIPPED_ARM]
    assert len(document["omissions"]) == len(ARMS) + 1
    write_page(tmp_path / "msdi.md", document)
    assert "still lacks runs" in (tmp_path / "msdi.md").read_text()


def test_without_time_arms_that_were_trained_are_told(work, told):
    found = bench_msdi([], work, silent, quick=True)
    again = bench_msdi([], work, silent, quick=True, time_left=lambda: False)
    assert (again.rows, again.omissions, len(told)) == (found.rows, found.omissions, len(ARMS))
