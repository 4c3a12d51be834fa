"""The defects bench: its list, its recordings, what it makes of its rows, and that it resumes."""

from pathlib import Path

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import BACKGROUNDS
from reconstruction.bench.conventions import truth_of
from reconstruction.bench.defects import bench, recordings
from reconstruction.bench.defects.bench import (
    BUILT,
    CLEAN,
    DEFECTS,
    FEW,
    RIG_OFF,
    STEPS,
    TOGETHER,
    bench_defects,
    costs,
)
from reconstruction.bench.defects.recordings import BARREL, Defect, recorded, straightened
from reconstruction.bench.diagrams import plot_defects
from reconstruction.run.configuration import ReconstructionConfig
from rigs.toml import catalog_rig

RUN = {"psnr_db": 36.0, "dynamic_psnr_db": 30.0, "abs_rel": 0.01}


def test_every_defect_is_a_simulation_and_its_cure_a_choice():
    assert len({defect.name for defect in DEFECTS}) == len(DEFECTS)
    for defect in (*DEFECTS, *FEW):
        Simulation("fan_and_ball", 1, **defect.simulated)
        ReconstructionConfig(steps=3, budget_s=None, **defect.uncured)
    assert {"lens", "pixels", "gains", "lags", "10-khz", "tenth-light"} <= {d.name for d in DEFECTS if d.curable}


def test_costs_are_against_the_clean_recording_of_the_same_scene():
    def row(scene: str, defect: str, cured: bool, psnr_db: float) -> dict:
        return RUN | {"scene": scene, "seed": 1, "defect": defect, "cured": cured, "psnr_db": psnr_db}

    rows = [
        row("a", "clean", True, 36.0),
        row("a", "lens", True, 35.5) | {"rotation_deg": 0.02},
        row("a", "lens", False, 25.0),
        row("a", "built", True, 38.0),
        row("a", "rig-off", True, 37.9),
        row("b", "clean", True, 40.0),
        row("b", "lens", True, 39.0),
        {"scene": "b", "seed": 1, "defect": "gains", "cured": True, "refused": "too dark"},
    ]
    found = costs(rows)
    assert found["a.lens.cost_db"] == pytest.approx(0.5)
    assert found["a.lens.uncured_cost_db"] == pytest.approx(11.0)
    assert found["a.lens.rotation_deg"] == 0.02
    assert found["a.built.cost_db"] == pytest.approx(-2.0)
    assert found["a.rig-off.cost_db"] == pytest.approx(0.1)  # from the same cameras, as built
    assert found["b.lens.cost_db"] == pytest.approx(1.0)
    assert found["b.clean.psnr_db"] == 40.0
    assert not any(key.startswith("b.gains") for key in found)


def test_a_recording_has_its_bent_lenses_its_rate_and_its_maps(tmp_path, monkeypatch):
    monkeypatch.setattr(recordings, "apart", lambda work: work())
    monkeypatch.setattr(recordings, "TICKS", 20)
    monkeypatch.setattr(recordings, "CALIBRATION_TICKS", 500)
    rig = catalog_rig("ci3x3").scaled(48, 30)
    rig = rig.only(rig.ids[:2])
    defect = Defect("some", TOGETHER.simulated, bent=True, rate_hz=10000, maps=True, uncured=TOGETHER.uncured)
    path = recorded(tmp_path, rig, ("fan_and_ball", 1), defect)
    found = Recording.open(path)
    assert (found.planes, found.tick_rate_hz) == (10, 10000)
    assert all(tuple(camera.distortion)[:2] == BARREL[:2] for camera in found.rig.cameras)
    assert all(camera.pixels is not None and camera.pixels.exists() for camera in found.rig.cameras)
    straight = Recording.open(straightened(path))
    assert not any(camera.bends for camera in straight.rig.cameras)
    np.testing.assert_array_equal(straight.stream("cam00").packed, found.stream("cam00").packed)


def test_a_rig_file_as_built_has_the_true_cameras(tmp_path, monkeypatch):
    monkeypatch.setattr(recordings, "apart", lambda work: work())
    monkeypatch.setattr(recordings, "TICKS", 20)
    rig = catalog_rig("ci3x3").scaled(48, 30)
    subject = ("fan_and_ball", 1)
    off, built = (Recording.open(recorded(tmp_path, rig, subject, defect)) for defect in (RIG_OFF, BUILT))
    true = truth_of(built).cameras(built.tick_rate_hz)
    assert true is not None
    for camera in built.rig.cameras:
        np.testing.assert_allclose(camera.cam_from_rig.matrix, true.camera(camera.id).cam_from_rig.matrix, atol=1e-12)
        assert camera.fx == pytest.approx(true.camera(camera.id).fx)
    assert (off.rig.poses, built.rig.poses) == ("nominal", "calibrated")
    np.testing.assert_array_equal(built.stream("cam00").packed, off.stream("cam00").packed)


def test_the_bench_resumes_and_says_what_it_left_out(tmp_path, monkeypatch):
    made: list[str] = []

    def told(work):
        made.append(work.args[1].name)
        return dict(RUN)

    monkeypatch.setattr(bench, "apart", told)
    monkeypatch.setattr(bench, "recorded", lambda work, rig, subject, defect: Path(f"{subject[0]}-{defect.name}"))
    monkeypatch.setattr(bench, "straightened", lambda path: path)
    scenes, drawn = [("fan_and_ball", 1)], [("plain_room", 1)]
    document = bench_defects(scenes, drawn, tmp_path, silent)
    curable = sum(defect.curable for defect in DEFECTS)
    assert len(document.rows) == 1 + len(DEFECTS) + curable + len(BACKGROUNDS) + 1 + len(FEW)
    assert f"fan_and_ball-1-lens-uncured-{STEPS}.run" in made
    assert document.summary["fan_and_ball.lens.cost_db"] == 0.0
    made.clear()
    again = bench_defects(scenes, drawn, tmp_path, silent)
    assert made == []
    assert again.rows == document.rows
    plot_defects(tmp_path / "defects.png", vars(again) | {"device": {"processor": "x", "threads": 2}, "revision": "r"})
    assert (tmp_path / "defects.png").stat().st_size > 0
    late = bench_defects(scenes, [], tmp_path / "late", silent, time_left=lambda: False)
    assert late.rows == []
    assert f"fan_and_ball, {CLEAN.name}: no time was left" in late.omissions
