"""Options of the benches of speed, and the clips and contenders that they make."""

import sys
from pathlib import Path

import pytest

from acquisition.progress import silent
from acquisition.scenes.catalog import DEVELOPMENT, DEVELOPMENT_SEEDS, REALISTIC
from reconstruction.bench.speed.bench import FULL, LARGE, LARGE_AGAIN, LARGE_QUICK, LARGE_SIZE, QUICK, SpeedBench
from server.cli import bench_asked
from server.cli.bench_asked import Asked


@pytest.fixture
def chosen(unrun, tmp_path):
    """Make the bench that options ask for."""
    return lambda name="speed", **options: unrun(SpeedBench, name, Asked(tmp_path, lambda _: silent, **options))


def test_the_full_bench_has_every_development_scene(chosen):
    bench = chosen()
    assert [clip.name for clip in bench.clips] == [*DEVELOPMENT, *REALISTIC]
    assert {clip.seed for clip in bench.clips} == {DEVELOPMENT_SEEDS[0]}
    assert [clip.runs for clip in bench.clips] == [FULL.runs] * 4
    assert [contender.said for contender in bench.contenders] == ["this revision"]


def test_scenes_narrow_it(chosen):
    assert [clip.name for clip in chosen(scenes="robot_arm").clips] == ["robot_arm"]
    quick = chosen(quick=True)
    assert ([clip.name for clip in quick.clips], quick.extent) == ([DEVELOPMENT[0]], QUICK)


def test_large_pictures_are_of_two_seeds_and_the_older_revision_has_the_first(chosen):
    bench = chosen("large")
    assert [clip.name for clip in bench.clips] == ["fan_and_ball-1-1000x1000", "fan_and_ball-2-1000x1000"]
    assert [clip.runs for clip in bench.clips] == [LARGE.runs, LARGE_AGAIN]
    assert (bench.name, bench.extent.steps, bench.extent.loaded) == ("large", (), None)
    quick = chosen("large", quick=True)
    assert ([clip.seed for clip in quick.clips], quick.extent) == ([1], LARGE_QUICK)


def test_a_command_to_compare_with_is_run_first(chosen):
    command = Path(sys.executable).with_name("spike4dgs")
    old, new = chosen(against=command).contenders
    assert (old.name, old.words, old.said) == ("old", (str(command),), str(command))
    assert (new.name, new.words) == ("new", (sys.executable, "-m", "server.cli"))


def test_a_large_recording_is_simulated_at_its_size(chosen, monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(bench_asked.subprocess, "run", lambda command, **_: calls.append(command) or Done())
    path = chosen("large").clips[-1].recorded()
    assert path == tmp_path / "large" / "400" / "fan_and_ball-2"
    assert calls[0][-2:] == ["--size", "x".join(map(str, LARGE_SIZE))]


class Done:
    """A command that ended well."""

    returncode = 0
