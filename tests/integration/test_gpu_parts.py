"""The parts of `make gpu` that need no GPU, small: a training on the processor, and its checkpoint compared."""

from pathlib import Path

import pytest
from maintenance.gpu import Measured, parts_of
from maintenance.gpu_measurements import VIEW, Place, compared

from reconstruction.rendering.gsplat_backend import why_unavailable

pytestmark = pytest.mark.slow


def test_a_training_is_measured_and_its_checkpoint_compared(small_recording: Path, tmp_path: Path) -> None:
    parts = {part.name: part for part in parts_of(tmp_path, small_recording, 30, 20.0, 0)}
    measured = Measured(tmp_path / "gpu.json", {"accelerator": "none"})
    measured.run(parts["training cpu 30 steps"], 300.0)
    (found,) = measured.rows[0]["found"]
    assert (found["device"], found["backend"], found["steps"]) == ("cpu", "native", 30)
    assert found["psnr_db"] > 10
    native = Place("native", "cpu")  # with itself: the reference would hold gigabytes of so many Gaussians
    rows = compared(tmp_path / "cpu-steps-30", VIEW, native, native)
    assert all(row["max"] == 0 and row["largest"] > 0 for row in rows), rows


@pytest.mark.skipif(why_unavailable() is None, reason="gsplat and a CUDA device are here")
def test_a_training_without_its_gpu_is_an_error_in_one_line(small_recording: Path, tmp_path: Path) -> None:
    parts = {part.name: part for part in parts_of(tmp_path, small_recording, 30, 20.0, 0)}
    measured = Measured(tmp_path / "gpu.json", {"accelerator": "none"})
    measured.run(parts["training cuda 30 steps"], 300.0)
    assert "found no GPU to train on" in measured.rows[0]["error"]
