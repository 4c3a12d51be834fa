"""The defects bench: its list, its recordings, what it makes of its rows, and that it resumes."""

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
    SEEDS,
    STEPS,
    TOGETHER,
    bench_defects,
    costs,
)
from reconstruction.bench.defects.recordings import BARREL, Defect, as_built, recorded, straightened
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


def row(scene: str, defect: str, cured: bool, psnr_db: float, training_seed: int = 0) -> dict:
    against = next(one.against for one in (CLEAN, *DEFECTS) if one.name == defect)
    about = {"scene": scene, "seed": 1, "defect": defect, "cured": cured, "psnr_db": psnr_db}
    return RUN | about | {"training_seed": training_seed, "against": against}


def test_costs_are_against_the_clean_recording_of_the_same_scene():
    rows = [
        row("a", "clean", True, 36.0),
        row("a", "lens", True, 35.5) | {"rotation_deg": 0.02},
        row("a", "lens", False, 25.0),
        row("a", "built", True, 38.0),
        row("a", "rig-off", True, 37.9),
        row("b", "clean", True, 40.0),
        row("b", "lens", True, 39.0),
        row("b", "gains", True, 0.0) | {"refused": "too dark"},
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
    assert not any("spread" in key or key.startswith("a.clean.cost") for key in found)


def test_a_cost_is_of_means_over_trainings_and_has_a_spread():
    levels = {"built": (36.0, 38.0, 37.0), "rig-off": (35.5, 36.5, 37.5)}
    rows = [row("a", name, True, db, seed) for name, found in levels.items() for seed, db in enumerate(found)]
    found = costs([*rows, row("a", "rig-off", False, 20.0)])
    assert found["a.built.psnr_db"] == pytest.approx(37.0)
    assert found["a.rig-off.cost_db"] == pytest.approx(0.5)
    assert found["a.rig-off.cost_spread_db"] == pytest.approx(2.0)  # of .5, 1.5 and -.5
    assert found["a.rig-off.dynamic_cost_spread_db"] == 0.0
    assert found["a.rig-off.uncured_cost_db"] == pytest.approx(17.0)
    assert "a.rig-off.uncured_cost_spread_db" not in found


def test_a_defect_is_held_against_a_recording_with_its_lens_and_its_maps():
    known = {defect.name: defect for defect in (CLEAN, *DEFECTS)}
    for name in ("pixels", "vignetting", "harsh", "together"):
        own, other = known[name], known[known[name].against]
        seen = other.told or other
        assert (own.maps, seen.maps) == (True, True)
        assert own.bent == seen.bent
        assert own.simulated.get("rig_error") == seen.simulated.get("rig_error")
        assert own.seeds == other.seeds
    assert {defect.against for defect in FEW} <= {CLEAN.name, *(defect.name for defect in FEW)}
    assert not TOGETHER.curable  # the search for poses would find the lens all the same


def test_a_recording_has_its_bent_lenses_its_rate_and_its_maps(tmp_path, monkeypatch):
    monkeypatch.setattr(recordings, "apart", lambda work: work())
    monkeypatch.setattr(recordings, "TICKS", 20)
    monkeypatch.setattr(recordings, "CALIBRATION_TICKS", 500)
    rig = catalog_rig("ci3x3").scaled(48, 30)
    rig = rig.only(rig.ids[:2])
    defect = Defect("some", TOGETHER.simulated, bent=True, rate_hz=10000, maps=True)
    path = recorded(tmp_path, rig, ("fan_and_ball", 1), defect)
    found = Recording.open(path)
    assert (found.planes, found.tick_rate_hz) == (10, 10000)
    assert all(tuple(camera.distortion)[:2] == BARREL[:2] for camera in found.rig.cameras)
    assert all(camera.pixels is not None and camera.pixels.exists() for camera in found.rig.cameras)
    built = Recording.open(as_built(path)).rig.cameras
    assert all(camera.bends and camera.pixels is not None and camera.pixels.exists() for camera in built)
    straight = Recording.open(straightened(path))
    assert not any(camera.bends for camera in straight.rig.cameras)
    np.testing.assert_array_equal(straight.stream("cam00").packed, found.stream("cam00").packed)


def test_instants_of_truth_are_the_same_at_every_rate(tmp_path, monkeypatch):
    monkeypatch.setattr(recordings, "apart", lambda work: work())
    monkeypatch.setattr(recordings, "TICKS", 60)
    rig = catalog_rig("ci3x3").scaled(16, 10).only(["cam00"])
    instants = {}
    for rate_hz in (None, 5000, 2000):
        defect = Defect(f"at-{rate_hz}", rate_hz=rate_hz)
        found = Recording.open(recorded(tmp_path, rig, ("fan_and_ball", 1), defect))
        instants[rate_hz] = [plane / found.tick_rate_hz for plane in truth_of(found).planes("cam00")]
    assert instants[None] == instants[5000] == instants[2000] == pytest.approx([0.0, 0.001, 0.002])


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
        recording, run, config = work.args
        made.append(run.name)
        assert (run.parent, recording.parent) == (tmp_path / "of-today", tmp_path / "of-today")
        assert config.seed == int(run.stem[-1])
        assert (config.pixels == "even") == any(
            f"-{name}-uncured" in run.name for name in ("pixels", "vignetting", "harsh")
        )
        return dict(RUN)

    monkeypatch.setattr(bench, "apart", told)
    monkeypatch.setattr(bench, "this_code", lambda: "of-today")
    monkeypatch.setattr(bench, "recorded", lambda work, rig, subject, defect: work / f"{subject[0]}-{defect.name}")
    monkeypatch.setattr(bench, "straightened", lambda path: path)
    scenes, drawn = [("fan_and_ball", 1)], [("plain_room", 1)]
    document = bench_defects(scenes, drawn, tmp_path, silent)
    runs = sum(len(defect.seeds) + defect.curable for defect in DEFECTS)
    assert len(document.rows) == 2 * len(SEEDS) + runs + len(BACKGROUNDS) + len(FEW) * len(SEEDS)
    assert len(set(made)) == len(document.rows)
    assert f"fan_and_ball-1-lens-uncured-{STEPS}-0.run" in made
    assert {row["training_seed"] for row in document.rows if row["defect"] == "together"} == set(SEEDS)
    assert document.summary["fan_and_ball.lens.cost_db"] == 0.0
    made.clear()
    again = bench_defects(scenes, drawn, tmp_path, silent)
    assert made == []
    assert again.rows == document.rows
    assert bench_defects(scenes, drawn, tmp_path, silent, time_left=lambda: False).rows == document.rows
    monkeypatch.setattr(bench, "code_and_machine", lambda: {"code": "of a mend"})
    bench_defects(scenes, drawn, tmp_path, silent)
    assert len(made) == len(document.rows)
    plot_defects(tmp_path / "defects.png", vars(again) | {"device": {"processor": "x", "threads": 2}, "revision": "r"})
    assert (tmp_path / "defects.png").stat().st_size > 0
    late = bench_defects(scenes, [], tmp_path / "late", silent, time_left=lambda: False)
    assert late.rows == []
    assert f"fan_and_ball, {CLEAN.name}: no time was left" in late.omissions
