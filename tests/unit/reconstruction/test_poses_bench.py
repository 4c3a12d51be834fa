"""The bench of poses resumes where its rows are of this code, networks included."""

from typing import Any

from acquisition.progress import silent
from reconstruction.bench import poses
from reconstruction.bench.conventions import KnownRecording
from reconstruction.bench.paper.digest import this_code
from reconstruction.bench.poses import BOARD, METHODS, bench_poses

ROW = {"scene": "some", "seed": 1, "nominal": 2.0, "views": 9, "seconds": 1.0, "rotation_deg": 0.1}


def test_rows_of_other_code_are_measured_again(tmp_path, monkeypatch):
    made = []

    def measured(method: str, *_: object, **__: object) -> dict[str, Any]:
        made.append(method)
        return ROW | {"method": method}

    monkeypatch.setattr(poses, "measured", measured)
    clips = [KnownRecording("some", 1, tmp_path)]
    document = bench_poses(clips, None, tmp_path / "work", silent, quick=True)
    assert made == [name for name in METHODS if name != BOARD]
    assert bench_poses(clips, None, tmp_path / "work", silent, quick=True).rows == document.rows
    assert len(made) == len(document.rows)
    monkeypatch.setattr(poses, "code_and_machine", lambda method: {"code": "of a mend"})
    bench_poses(clips, None, tmp_path / "work", silent, quick=True)
    assert len(made) == 2 * len(document.rows)


def test_networks_are_part_of_its_code():
    assert this_code(poses.LEARNED) != this_code()
