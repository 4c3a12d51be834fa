"""The leave-out bench: its cases, what it makes of its rows, that it resumes, and the mover that a plan misses."""

import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import SCENES, build_scene
from acquisition.scenes.source import SceneSource
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.diagrams import plot_leave_out
from reconstruction.bench.leave_out import bench, run
from reconstruction.bench.leave_out.bench import BUDGET_S, SIZE, STEPS, Runs, bench_leave_out, claims, costs, recorded
from reconstruction.bench.leave_out.cases import CASES, COLOUR, GREY, MISSED, PLAN, TICKS, UNWATCHED, PlanCase
from reconstruction.bench.leave_out.run import EveryChannel, Memory
from reconstruction.images.background import moving_pixels
from reconstruction.images.flicker import Light
from reconstruction.rendering.result import Rendering
from reconstruction.run.plan import STILL_SHARE
from reconstruction.training.changed_pixels import changed_pixels
from reconstruction.training.image_term import ImageTerm
from reconstruction.training.view import TrainingView
from rigs.clock import RigClock
from rigs.toml import catalog_rig

RUN = {"cpu_s": 10.0, "seconds": 6.0, "peak_mb": 300.0, "psnr_db": 30.0, "dynamic_psnr_db": 25.0}
SAID = {"motion": {"choice": "static", "reason": "", "saves_s": 3.0, "saves_bytes": None}}


def test_every_case_is_a_configuration_of_a_known_scene():
    assert len({case.name for case in CASES}) == len(CASES)
    for case in (*CASES, MISSED):
        assert case.scene in SCENES
        for arm in (PLAN, case.all, UNWATCHED, *case.switches):
            assert arm.config(steps=3).steps == 3
            assert arm.config(budget_s=2.0).budget_s == 2.0
        assert case.dead is None or case.dead in case.all.config(steps=1).views


def test_what_a_plan_costs_and_saves_is_against_the_other_run():
    other = RUN | {"cpu_s": 14.0, "peak_mb": 350.0, "psnr_db": 30.2, "dynamic_psnr_db": 24.5}
    expected = {"x.saved_s": 4.0, "x.saved_mb": 50.0, "x.cost_db": 0.2, "x.dynamic_cost_db": -0.5}
    assert costs("x", RUN, other) == pytest.approx(expected)
    assert costs("x", RUN, {"refused": "too dark"}) == {}
    assert claims("x", RUN | {"decisions": SAID}, "motion") == {"x.claimed_s": 3.0}
    assert claims("x", RUN, "motion") == {}


@pytest.fixture
def made(monkeypatch):
    """Every process that the bench starts, whose work is not done: a run is so long as its arm's name."""
    calls = []

    def told(work):
        (job,) = work.args
        calls.append(job.out.name)
        found = RUN | {"cpu_s": float(len(job.arm.name)), "steps": job.steps or 99}
        watch = {"choice": "", "reason": "", "facts": {"pixels": 9, "views": 2, "gaussians": 4, "step": 175}}
        return found | {"decisions": SAID | {"watch": watch}}

    monkeypatch.setattr(bench, "recorded", lambda case, work: work / case.scene)
    monkeypatch.setattr(bench, "apart", told)
    return calls


def test_the_document_has_every_case_and_nothing_is_run_twice_by_one_code(made, monkeypatch, tmp_path):
    document = bench_leave_out(tmp_path, silent).to_json()
    runs = sum(4 + len(case.switches) for case in CASES) + 3  # grey beside colour, and the two of the missed mover
    assert len(made) == len(set(made)) == len(document["rows"]) == runs
    summary = document["summary"]
    assert summary["static.saved_s"] == len("all") - len("plan")
    assert summary["static.motion.saved_s"] == len("motion") - len("plan")
    assert summary["mono.colour.saved_s"] == len("colour") - len("grey")
    assert summary["static.motion.claimed_s"] == 3.0
    assert f"calibrated.cost_db@{BUDGET_S:g}" in summary
    assert (summary["missed-mover.found"], summary["missed-mover.found_at_step"]) == (1.0, 175.0)
    made.clear()
    again = bench_leave_out(tmp_path, silent).to_json()
    assert not made
    assert again["summary"] == summary
    with monkeypatch.context() as mended:
        mended.setattr(bench, "code_and_machine", lambda: {"code": "of a mend"})
        bench_leave_out(tmp_path, silent)
        assert len(made) == runs
        mended.setattr(bench, "this_code", lambda: "mended")
        bench_leave_out(tmp_path, silent)
    assert len(made) == 2 * runs
    assert (tmp_path / "mended").is_dir()  # with recordings of its own
    plot_leave_out(tmp_path / "a.png", document)
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_without_time_cases_that_were_measured_are_told_and_others_are_left_out(made, tmp_path):
    found = bench_leave_out(tmp_path, silent, cases=CASES[:1])
    made.clear()
    late = bench_leave_out(tmp_path, silent, cases=CASES[:2], time_left=lambda: False)
    assert not made
    assert (late.rows, late.summary) == (found.rows, found.summary)
    assert f"{CASES[1].name}: no time was left" in late.omissions


def test_a_quick_bench_has_equal_steps_of_one_case_alone(made, tmp_path):
    document = bench_leave_out(tmp_path, silent, quick=True)
    assert {row["case"] for row in document.rows} == {CASES[0].name}
    assert len({row["extent"] for row in document.rows}) == 1


def test_a_refused_run_is_named_and_compared_with_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "recorded", lambda case, work: work)
    monkeypatch.setattr(bench, "apart", lambda work: {"refused": "too dark"})
    document = bench_leave_out(tmp_path, silent, quick=True)
    assert document.summary == {}
    assert any("static, all, plan: refused, too dark" in omission for omission in document.omissions)


def test_three_equal_channels_are_trained_as_one_is():
    generator = torch.Generator().manual_seed(0)
    light, target = torch.rand(24, 32, 1, generator=generator), torch.rand(24, 32, generator=generator)
    none, grey = torch.zeros(24, 32), ImageTerm(RigClock(20000.0), 0.6, 4)
    camera = catalog_rig("ci3x3").cameras[0]
    view = TrainingView(camera, SimpleNamespace(straightening=None))  # pyright: ignore[reportArgumentType]
    one, three = (Rendering(light.repeat(1, 1, n), none, none, none) for n in (1, 3))
    assert float(EveryChannel(grey).held(view, three, target)) == pytest.approx(float(grey.held(view, one, target)))
    assert (GREY.channels, COLOUR.channels) == (1, 3)


def test_memory_is_the_most_that_was_held(monkeypatch):
    held, seen = [100.0], threading.Event()

    def held_mb() -> float:
        if held[0] > 300:
            seen.set()
        return held[0]

    monkeypatch.setattr(run, "held_mb", held_mb)
    with Memory() as memory:
        assert memory.peak_mb == 100.0
        held[0] = 400.0
        assert seen.wait(60)
        held[0] = 50.0
    assert memory.peak_mb == 400.0


def test_anonymous_memory_is_that_of_this_process():
    measure = "from reconstruction.bench.leave_out.run import held_mb as mb"
    code = f"{measure}; was = mb(); held = b'x' * (200 << 20); print(mb() - was)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert float(said) == pytest.approx(200 * 1.048576, rel=0.1)


@pytest.mark.parametrize("seed", [1, MISSED.seed])
def test_the_plan_sees_the_card_of_faint_and_the_watch_would_too(seed):
    camera, layout = catalog_rig("lab3x3").scaled(*SIZE).camera("cam01"), PlaneLayout(*SIZE)
    sensor = Sensor(*SIZE, "real", seed, 1)
    source = SceneSource(build_scene(MISSED.scene, seed), camera, RigClock(20000.0), TICKS, sensor, layout)
    stream, light = SpikeStream(source.next_planes(TICKS), layout, 20000.0), Light.steady(TICKS)
    assert moving_pixels(stream, light).mean() > 20 * STILL_SHARE
    assert changed_pixels(stream, np.ones(SIZE[::-1], bool), light).sum() > 300


@pytest.mark.slow
@pytest.mark.long
def test_a_dead_camera_is_skipped_by_the_plan_and_kept_where_it_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "SIZE", (100, 62))
    (dead,) = (case for case in CASES if case.dead)
    small = PlanCase("small", "static", 1, dead.switches, ticks=64, dead=dead.dead, otherwise=dead.otherwise)
    recording = Recording.open(recorded(small, tmp_path))
    assert not recording.stream("cam00").counts(0, 64).any()
    assert recording.stream("cam22").counts(0, 64).any()
    document = bench_leave_out(tmp_path, silent, quick=True, cases=(small,))
    rows = {(row["decision"], row["run"]): row for row in document.rows}
    assert rows["all", "plan"]["views"] == 7
    assert rows["views", "all"]["views"] == 8
    assert all(row["psnr_db"] > 10 and row["peak_mb"] > 50 for row in document.rows)
    assert document.summary["small.views.claimed_s"] > 0
    assert not list(tmp_path.glob("*.run"))
    assert Runs(tmp_path).steps == STEPS
