import math

import pytest
import torch

from reconstruction.training.closeness import MEMORY, Closeness


def test_it_is_the_psnr_of_a_running_mean():
    found = Closeness(white=0.5)
    assert (found.psnr_db, str(found)) == (None, "")
    target = torch.zeros(4, 6)
    found.see(target + 0.05, target)
    assert found.psnr_db == pytest.approx(20.0, abs=1e-4)
    found.see(target + 0.005, target)
    assert found.psnr_db == pytest.approx(10 * math.log10(0.25 / ((0.05**2 + 0.005**2) / 2)), abs=1e-4)
    assert str(found) == f", training PSNR {found.psnr_db:.2f} dB"


def test_it_forgets_what_is_long_past():
    found = Closeness(white=1.0)
    target = torch.zeros(2, 2)
    found.see(target + 1, target)
    for _ in range(20 * MEMORY):
        found.see(target + 0.01, target)
    assert found.psnr_db == pytest.approx(40.0, abs=0.01)


def test_equal_images_and_broken_ones_give_no_figure():
    found = Closeness(white=1.0)
    found.see(torch.ones(2, 2), torch.ones(2, 2))
    assert found.psnr_db is None
    found.see(torch.full((2, 2), math.nan), torch.ones(2, 2))
    assert found.psnr_db is None
