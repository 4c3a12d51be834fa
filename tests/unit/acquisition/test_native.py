import ctypes

import numpy as np
import pytest
import torch

from acquisition.native import Address, Kernel

UNPACK = Kernel("acquisition", "unpack_planes", Address, ctypes.c_int64, *(ctypes.c_int32,) * 4, Address)


@pytest.mark.parametrize("kind", ["array", "tensor"])
def test_kernels_take_arrays_and_tensors(kind):
    packed, planes = np.array([[0], [5]], np.uint8), np.empty((2, 8), np.uint8)
    UNPACK(torch.from_numpy(packed) if kind == "tensor" else packed, 2, 8, 1, 0, 0, planes)
    assert planes.tolist() == [[0] * 8, [1, 0, 1, 0, 0, 0, 0, 0]]


def test_kernels_refuse_what_does_not_lie_in_one_piece():
    with pytest.raises(ctypes.ArgumentError, match="strided"):
        UNPACK(np.zeros((4, 8), np.uint8)[:, ::2], 4, 8, 1, 0, 0, None)
    with pytest.raises(ctypes.ArgumentError, match="an array, a tensor or None"):
        UNPACK([5], 1, 8, 1, 0, 0, None)
