"""Options of the speed bench, and the clips and contenders that they make."""

import sys
from pathlib import Path

import pytest

from acquisition.bench_document import BenchDocument
from acquisition.progress import silent
from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, REALISTIC
from reconstruction.bench.speed import FULL, LARGE_RUNS, LARGE_SIZE, QUICK, SpeedBench
from server.cli import bench_asked
from server.cli.bench_asked import Asked
from server.cli.bench_runs import BENCHES

LARGE = f"{DEVELOPMENT[0]}-1000x1000"


@pytest.fixture
def chosen(monkeypatch, tmp_path):
    """Make the bench that options ask for, without running it."""
    made: list[SpeedBench] = []

    def keep(self):
        made.append(self)
        return BenchDocument("speed")

    monkeypatch.setattr(SpeedBench, "run", keep)

    def choose(**options) -> SpeedBench:
        BENCHES["speed"].run(Asked(tmp_path, lambda _: silent, **options))
        return made.pop()

    return choose


def test_the_full_bench_has_every_development_scene_and_large_pictures(chosen):
    bench = chosen()
    assert [clip.name for clip in bench.clips] == [*DEVELOPMENT, *REALISTIC, LARGE]
    assert {clip.seed for clip in bench.clips} == {DEVELOPMENT_SEEDS[0]}
    assert [clip.runs for clip in bench.clips] == [FULL.runs] * 4 + [LARGE_RUNS]
    assert [contender.said for contender in bench.contenders] == ["this revision"]


def test_scenes_narrow_it_and_large_pictures_are_asked_for(chosen):
    assert [clip.name for clip in chosen(scenes="robot_arm").clips] == ["robot_arm"]
    assert [clip.name for clip in chosen(scenes="robot_arm", large=True).clips] == ["robot_arm", LARGE]
    quick = chosen(quick=True)
    assert ([clip.name for clip in quick.clips], quick.extent) == ([DEVELOPMENT[0]], QUICK)


def test_a_command_to_compare_with_is_run_first(chosen):
    command = Path(sys.executable).with_name("spike4dgs")
    old, new = chosen(against=command).contenders
    assert (old.name, old.words, old.said) == ("old", (str(command),), str(command))
    assert (new.name, new.words) == ("new", (sys.executable, "-m", "server.cli"))


def test_a_large_recording_is_simulated_at_its_size(chosen, monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(bench_asked.subprocess, "run", lambda command, **_: calls.append(command) or Done())
    path = chosen(scenes="robot_arm", large=True).clips[-1].recorded()
    assert path == tmp_path / "1000x1000" / "fan_and_ball-1"
    assert calls[0][-2:] == ["--size", "x".join(map(str, LARGE_SIZE))]


class Done:
    """A command that ended well."""

    returncode = 0
