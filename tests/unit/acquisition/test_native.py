import ctypes

import numpy as np
import pytest
import torch

from acquisition.native import Address, Kernel

SENSOR = Kernel(
    "acquisition", "sensor_ideal", Address, ctypes.c_int64, ctypes.c_int64, Address, Address, ctypes.c_int32
)


@pytest.mark.parametrize("kind", ["array", "tensor"])
def test_kernels_take_arrays_and_tensors(kind):
    light, charge, spikes = np.full((4, 8), 0.5, np.float32), np.zeros(8, np.uint64), np.zeros((4, 8), np.uint8)
    SENSOR(torch.from_numpy(light) if kind == "tensor" else light, 4, 8, charge, spikes, 1)
    assert spikes.sum(axis=1).tolist() == [0, 8, 0, 8]


def test_kernels_refuse_what_does_not_lie_in_one_piece():
    with pytest.raises(ctypes.ArgumentError, match="strided"):
        SENSOR(np.zeros((4, 8), np.float32)[:, ::2], 4, 4, None, None, 1)
    with pytest.raises(ctypes.ArgumentError, match="an array, a tensor or None"):
        SENSOR([0.5], 1, 1, None, None, 1)
