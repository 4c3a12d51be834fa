import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import reconstruction.images.methods
from acquisition.spikes.layout import PlaneLayout
from reconstruction.errors import BadRunError
from reconstruction.images.catalogue import GIVEN, method, method_for, methods, names, price_s, sources


def test_every_file_of_the_package_is_a_method_of_that_name():
    files = {path.stem for path in Path(reconstruction.images.methods.__file__).parent.glob("*.py")} - {"__init__"}
    assert set(names()) == files
    assert sources() == (*names(), "clean", "blurred", "ordinary")
    assert all(price_s(name) > 0 for name in names())
    assert {price_s(name) for name in GIVEN} == {0.0}


def test_listing_the_methods_imports_no_torch():
    code = "import sys; from reconstruction.images.catalogue import names; names(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_weights_go_to_learned_methods_alone(tmp_path):
    assert method("blindspot", tmp_path / "own.npz").make.keywords == {"weights": tmp_path / "own.npz"}
    with pytest.raises(BadRunError, match="found weights for the method 'tfp', expected one of"):
        method("tfp", tmp_path / "own.npz")
    with pytest.raises(BadRunError, match="found the image method 'crystal', expected one of"):
        method("crystal")


def test_a_method_that_focuses_is_told_the_pixels_and_any_other_is_returned_as_it_is():
    layout, pixels = PlaneLayout(9, 3), np.eye(3, 9, dtype=bool)
    assert method_for("tfi", layout, pixels) is methods()["tfi"]
    assert method_for("interpolated", layout, pixels).make.keywords["focus"].packed.dtype == np.uint8
