"""Calls of this package's native kernels, each declared with its argument types."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from acquisition.native import Address, Kernel

if TYPE_CHECKING:
    from torch import Tensor

Int, Long, Float, Double = ctypes.c_int32, ctypes.c_int64, ctypes.c_float, ctypes.c_double
Addresses = ctypes.POINTER(ctypes.c_void_p)  # argument type that goes with `addresses`


def kernel(name: str, *argument_types: Any, returns: Any = None) -> Kernel:
    """Return the kernel `name`; `Address` stands for an array or tensor, ctypes' types for numbers and structures."""
    return Kernel("reconstruction", name, *argument_types, returns=returns)


_team: ContextVar[int | None] = ContextVar("team", default=None)


def threads() -> int:
    """Return the number of threads that a kernel takes: as many as torch has outside `kernels_alone`."""
    import torch

    return _team.get() or torch.get_num_threads()


@contextmanager
def kernels_alone() -> Iterator[None]:
    """Let kernels alone have several threads inside the block, and torch's own operations one.

    Where these are small, they are over before a second thread has woken up.
    """
    import torch

    before, token = torch.get_num_threads(), _team.set(threads())
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _team.reset(token)


def addresses(*tensors: Tensor | None) -> ctypes.Array:
    """Return the addresses of contiguous tensors, null for None, as a C array."""
    return (ctypes.c_void_p * len(tensors))(*(Address.from_param(t) for t in tensors))


def fits(*tensors: Tensor) -> bool:
    """Return whether kernels can take all these tensors: float32 on the CPU."""
    import torch  # not above: matching and sweeping call kernels without it

    return all(t.dtype == torch.float32 and t.device.type == "cpu" for t in tensors)
