"""Quaternions: length one, any length in, and NaN that stays NaN."""

import pytest
import torch

from reconstruction.quaternions import matrices, unit

TURN = torch.tensor([0.5, -0.5, 0.5, 0.5])


@pytest.mark.parametrize("scale", [1.0, 1e-20, 1e20])
def test_any_length_becomes_one(scale):
    torch.testing.assert_close(unit(scale * TURN), TURN)


def test_four_zeros_are_no_rotation():
    torch.testing.assert_close(matrices(torch.zeros(2, 4)), torch.eye(3).expand(2, 3, 3))


@pytest.mark.parametrize("which", [[0], [2], [0, 1, 2, 3]])
def test_nan_is_not_taken_for_no_rotation(which):
    quats = torch.stack([TURN, TURN])
    quats[0, which] = torch.nan
    assert unit(quats)[0].isnan().all()
    assert matrices(quats)[0].isnan().any()
    torch.testing.assert_close(unit(quats)[1], TURN)
