"""The processes of the speed bench: older commands, runs that end or fail, steps on demand, and the whole in small."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from reconstruction.bench.rasterizer import PARTS
from reconstruction.bench.speed.run import NEW, OLD, Contender, Steppers, StepSize, busy_thread, run_to_end
from reconstruction.bench.speed.step_times import WHOLE
from reconstruction.errors import BadRunError, ReconstructionError

COMMAND = Path(sys.executable).with_name("spike4dgs")
PRETENDS = """
import json, os, pathlib, sys
assert os.environ["OMP_WAIT_POLICY"] == "passive" and "PYTHONPATH" not in os.environ
assert sys.argv[1:3] == ["reconstruct", "some recording"] and sys.argv[-5:-3] == ["--holdout", "cam11"]
held = bytearray(200_000_000)
out = pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
out.mkdir()
run = {"revision": "older", "seconds": {"train": 1.0, "report": 0.25}, "steps": 7}
run["gaussians"] = {"still": 3, "moving": 2}
(out / "run.json").write_text(json.dumps(run))
(out / "metrics.json").write_text(json.dumps({"psnr_db": 30.0, "abs_rel": 0.1, "ssim": 0.9}))
import time; time.sleep(0.4)
"""


def script(path: Path, text: str, first: str = f"#!{sys.executable}") -> Path:
    path.write_text(f"{first}\n{text}\n")
    path.chmod(0o755)
    return path


def test_a_run_has_its_seconds_without_the_report_and_its_own_memory(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "elsewhere")
    old = Contender.installed(script(tmp_path / "spike4dgs", PRETENDS))
    row = run_to_end(old, Path("some recording"), tmp_path / "run", 12.0)
    assert row["seconds"] == pytest.approx(row["wall_s"] - 0.25)
    assert 200 < row["peak_mb"] < 280  # whatever this process holds
    assert (row["steps"], row["gaussians"], row["revision"], row["seconds.train"]) == (7, 5, "older", 1.0)
    assert (row["psnr_db"], row["abs_rel"]) == (30.0, 0.1)
    assert "ssim" not in row
    assert "dynamic_psnr_db" not in row
    assert 0 <= row["stolen"] < 1
    assert row["cpu_s"] > 0
    assert not (tmp_path / "run").exists()


def test_a_run_that_fails_says_why_and_leaves_nothing(tmp_path):
    text = "import os, sys; os.mkdir(sys.argv[4]); sys.exit('first\\nspike4dgs: too dark')"
    old = Contender.installed(script(tmp_path / "spike4dgs", text))
    with pytest.raises(ReconstructionError, match=r"found exit code 1 \(spike4dgs: too dark\)"):
        run_to_end(old, Path("some recording"), tmp_path / "run", 12.0)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("first", [f"#!{sys.executable}", f"#! {sys.executable}"])
def test_the_python_of_a_command_is_in_its_first_line(first, tmp_path):
    old = Contender.installed(script(tmp_path / "spike4dgs", "", first))
    assert (old.name, old.python, old.said) == (OLD, Path(sys.executable), str(tmp_path / "spike4dgs"))


def test_a_first_line_too_long_for_the_system_leaves_the_python_beside_the_command(tmp_path):
    command = script(tmp_path / "spike4dgs", '\'\'\'exec\' "/a long way/python" "$0" "$@"', "#!/bin/sh")
    with pytest.raises(BadRunError, match="that pip installed"):
        Contender.installed(command)
    script(tmp_path / "python", "")
    assert Contender.installed(command).python == tmp_path / "python"


def test_a_command_without_the_packages_has_no_revision(tmp_path):
    python = script(tmp_path / "python", "import sys; sys.exit('no module named acquisition')")
    old = Contender.installed(script(tmp_path / "spike4dgs", "", f"#!{python}"))
    with pytest.raises(ReconstructionError, match="no module named acquisition"):
        old.revision()


def test_steps_that_end_early_are_no_answer(tmp_path):
    python = script(tmp_path / "python", "print('\"r\"', flush=True)")
    old = Contender.installed(script(tmp_path / "spike4dgs", "", f"#!{python}"))
    with Steppers() as steppers, pytest.raises(ReconstructionError, match="the steps ended"):
        steppers.steps(old, StepSize(10, 40, 25, 1), 1)


def test_a_busy_thread_is_busy_and_ends_with_its_block():
    before = os.times()
    with busy_thread():
        time.sleep(0.5)
    spent = os.times()
    assert spent.children_user + spent.children_system > before.children_user + before.children_system


@pytest.mark.slow
def test_steps_are_timed_by_the_python_of_either_revision():
    old, new = Contender.installed(COMMAND), Contender(NEW, (), Path(sys.executable))
    with Steppers() as steppers:
        for contender in (old, new, old):
            for threads in (1, 2):
                steps = steppers.steps(contender, StepSize(500, 80, 50, 3), threads)
                assert len(steps) == 3
                assert all(step.keys() == {WHOLE, *PARTS} and min(step.values()) > 0 for step in steps)
    assert steppers.revisions == {OLD: old.revision(), NEW: new.revision()}


@pytest.mark.slow
@pytest.mark.long
def test_the_bench_compares_this_command_with_itself(tmp_path):
    command = [sys.executable, "-m", "server.cli", "bench", "speed", "--quick", "--json", "--out", str(tmp_path)]
    command += ["--against", str(COMMAND)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    document = json.loads(done.stdout)
    assert {(row["part"], row["which"]) for row in document["rows"]} == {
        (part, which) for part in ("ends", "steps", "loaded") for which in (OLD, NEW)
    }
    assert {"fan_and_ball.new@3-old@6.psnr_db", "fan_and_ball.points_x_old", "loaded.x_old"} <= document[
        "summary"
    ].keys()
    assert (tmp_path / "speed.png").stat().st_size > 10_000
    assert (tmp_path / "speed-movers.jpg").stat().st_size > 10_000
    assert document["revision"] in (tmp_path / "speed.md").read_text()
    assert json.loads((tmp_path / "speed.json").read_text()) == document
    assert not list(tmp_path.rglob("*.run"))
    again = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=100).stdout)
    assert again["rows"] == document["rows"]
