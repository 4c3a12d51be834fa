"""The parts of `make gpu` as far as a processor reaches: renderers compared, and parts run, kept and gone on with."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from maintenance import gpu
from maintenance.gpu import Measured, Part, counts_of, figures, last_line, measure, output_of, parts_of
from maintenance.gpu_measurements import Place, apart, times

from reconstruction.bench.rasterizer import random_cloud
from reconstruction.errors import BadRunError
from reconstruction.rendering.gsplat_backend import why_unavailable
from rigs.toml import catalog_rig

CAMERA = catalog_rig("lab3x3").camera("cam11").scaled(48, 30)
NATIVE, REFERENCE = Place("native", "cpu"), Place("reference", "cpu")
MACHINE = {"accelerator": "a card", "driver": "1", "torch": "2"}


def python(name: str, code: str, limit_s: float = 60.0, read=last_line, leaves: Path | None = None) -> Part:
    return Part(name, limit_s, ("-c", code), read, leaves)


def document(out: Path) -> dict:
    return json.loads(out.read_text())


@pytest.fixture(autouse=True)
def revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "code_revision", lambda: "abc")


def test_both_renderers_are_timed() -> None:
    rows = times((40,), (NATIVE, REFERENCE), CAMERA, repeats=1)
    assert [(row["backend"], row["gaussians"]) for row in rows] == [("native", 40), ("reference", 40)]
    assert all(row["forward_ms"] > 0 and row["backward_ms"] > 0 for row in rows)


def test_renderers_are_held_against_one_another() -> None:
    cloud = random_cloud(150, CAMERA)
    rows = apart(cloud, CAMERA, NATIVE, REFERENCE)
    assert [row["of"] for row in rows][:3] == ["intensity", "depth", "alpha"]
    assert len(rows) == 8
    for row in rows:
        assert row["mean"] <= row["max"] < 2e-3, row
        assert row["largest"] > 0
    assert all(row["max"] == 0 for row in apart(cloud, CAMERA, NATIVE, NATIVE))


def test_each_part_is_written_as_it_ends_and_not_run_again(tmp_path: Path) -> None:
    out, ran = tmp_path / "gpu.json", tmp_path / "ran"
    found = [{"of": "depth", "max": 2, "mean": 1}]
    good = f"import json; open({str(ran)!r}, 'a').write('x'); print('hello'); print(json.dumps({found}))"
    bad = "raise SystemExit('found it' + chr(10) + 'broken')"
    parts = [python("good", good), python("bad", bad), python("odd", "print('?')")]
    measure(Measured(out, MACHINE), parts, 60.0)
    rows = {row["part"]: row for row in document(out)["rows"]}
    assert rows["good"]["found"] == found
    assert rows["bad"]["error"] == "broken"
    assert "\n" not in rows["odd"]["error"]
    assert document(out)["device"].items() >= MACHINE.items()
    assert document(out)["summary"]["depth.max"] == 2
    assert [line.split(":")[0] for line in document(out)["omissions"]] == ["bad", "odd"]
    again = Measured(out, MACHINE)
    assert [part.name for part in again.missing(parts)] == ["bad", "odd"]
    measure(again, parts, 60.0)
    assert ran.read_text() == "x"
    assert len(document(out)["rows"]) == 3
    assert Measured(out, MACHINE | {"accelerator": "another"}).missing(parts) == parts


def test_a_part_of_other_code_is_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, parts = tmp_path / "gpu.json", [python("good", "print('[]')")]
    measure(Measured(out, MACHINE), parts, 60.0)
    monkeypatch.setattr(gpu, "code_revision", lambda: "abc-dirty")
    assert Measured(out, MACHINE).missing(parts) == []
    monkeypatch.setattr(gpu, "code_revision", lambda: "abd")
    assert Measured(out, MACHINE).missing(parts) == parts


def test_a_part_whose_folder_is_gone_is_run_again_in_a_fresh_one(tmp_path: Path) -> None:
    out, folder = tmp_path / "gpu.json", tmp_path / "made"
    part = python("recording", f"import os; os.mkdir({str(folder)!r}); print('[]')", leaves=folder)
    folder.mkdir()
    (folder / "half").touch()
    measure(Measured(out, MACHINE), [part], 60.0)
    assert list(folder.iterdir()) == []
    assert Measured(out, MACHINE).missing([part]) == []
    folder.rmdir()
    assert Measured(out, MACHINE).missing([part]) == [part]


def test_what_takes_too_long_is_ended_with_all_it_started() -> None:
    code = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(600)'])"
    with pytest.raises(BadRunError, match="took more than 1 s"):  # and returns, though the child had the pipes
        output_of(("-c", code), 1.0)


def test_what_there_is_no_time_for_is_told(tmp_path: Path) -> None:
    out = tmp_path / "gpu.json"
    measure(Measured(out, MACHINE), [python("good", "print('[]')")], 5.0)
    assert document(out)["omissions"] == ["good: not begun, 5 s were over"]
    assert document(out)["rows"] == []


def test_figures_have_names_of_their_own() -> None:
    timed = {"backend": "gsplat", "gaussians": 48_000, "forward_ms": 1.0, "backward_ms": 2.0}
    row = {"part": "times", "seconds": 3.0, "found": [timed]}
    assert figures(row) == {"seconds.times": 3.0, "gsplat.forward_ms@48k": 1.0, "gsplat.backward_ms@48k": 2.0}
    learnt = {"device": "cuda", "length": "60 s", "psnr_db": 30.0, "train_s": 40.0, "steps": 9, "backend": "gsplat"}
    found = figures({"part": "training", "seconds": 1.0, "found": [learnt]})
    assert found["cuda.psnr_db@60_s"] == 30.0
    assert found["cuda.steps@60_s"] == 9
    assert figures({"part": "bad", "seconds": 1.0, "error": "why"}) == {"seconds.bad": 1.0}


@pytest.mark.parametrize(
    ("line", "counts"),
    [
        ("3 passed, 1 skipped, 900 deselected in 4.20s", {"passed": 3, "skipped": 1, "deselected": 900}),
        ("1 passed in 61.00s (0:01:01)", {"passed": 1}),
    ],
)
def test_the_last_line_of_tests_is_read(line: str, counts: dict[str, int]) -> None:
    assert counts_of(f"....\nSKIPPED [1] a.py:5: why\n{line}\n") == [counts]


def test_the_parts_are_what_was_asked_for(tmp_path: Path) -> None:
    names = [part.name for part in parts_of(tmp_path, None, 50, 20.0, 0)]
    assert names[:4] == ["kernels", "tests", "times", "recording"]
    trainings = [f"training {one} {much}" for much in ("50 steps", "20 s") for one in ("cuda", "cpu")]
    assert names[4:] == [*trainings, "apart"]
    asked = [part.name for part in parts_of(tmp_path, tmp_path / "own", 50, 20.0, 10)]
    assert "recording" not in asked
    assert asked[-2:] == ["clips", "network"]


@pytest.mark.skipif(why_unavailable() is None, reason="gsplat and a CUDA device are here")
def test_without_a_gpu_it_ends_with_one_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "maintenance.gpu", "--out", str(tmp_path / "o"), "--work", str(tmp_path / "w")]
    done = subprocess.run(command, cwd=gpu.ROOT / "tests", capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith(f"Error: found no GPU to measure ({why_unavailable()}), expected gsplat and a CUDA")
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []
