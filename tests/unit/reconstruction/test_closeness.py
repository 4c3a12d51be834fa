import math

import pytest

from reconstruction.training.closeness import MEMORY, Closeness


def test_it_is_the_psnr_of_a_running_mean():
    found = Closeness(white=0.5)
    assert (found.psnr_db, str(found)) == (None, "")
    found.see(0.05**2)
    assert found.psnr_db == pytest.approx(20.0, abs=1e-4)
    found.see(0.005**2)
    assert found.psnr_db == pytest.approx(10 * math.log10(0.25 / ((0.05**2 + 0.005**2) / 2)), abs=1e-4)
    assert str(found) == f", training PSNR {found.psnr_db:.2f} dB"


def test_it_forgets_what_is_long_past():
    found = Closeness(white=1.0)
    found.see(1.0)
    for _ in range(20 * MEMORY):
        found.see(0.01**2)
    assert found.psnr_db == pytest.approx(40.0, abs=0.01)


def test_equal_images_and_broken_ones_give_no_figure():
    found = Closeness(white=1.0)
    found.see(0.0)
    assert found.psnr_db is None
    found.see(math.nan)
    assert found.psnr_db is None
