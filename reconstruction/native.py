"""Calls of this package's native kernels, each declared with its argument types."""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import TYPE_CHECKING, Any, TypeVar

from acquisition.native import Address, Kernel

if TYPE_CHECKING:
    from torch import Tensor

Int, Long, Float, Double = ctypes.c_int32, ctypes.c_int64, ctypes.c_float, ctypes.c_double
Addresses = ctypes.POINTER(ctypes.c_void_p)  # argument type that goes with `addresses`
Item = TypeVar("Item")
Result = TypeVar("Result")


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


def shared_out(work: Callable[[Item], Result], items: Iterable[Item], most: int | None = None) -> Iterator[Result]:
    """Yield what `work` makes of each item, in their order, as many at a time as torch has threads.

    Each is made by one thread, its kernels and torch's operations included: no core waits for another at the end of
    every loop. At most `most` are made at a time; kernels of each then have an equal share of the threads. A few items
    are taken ahead, and no more.
    """
    import torch

    team, under_way = threads(), deque[Future[Result]]()
    workers = min(team, most or team)

    def alone(item: Item) -> Result:
        _team.set(team // workers)  # of the item's own context
        return work(item)

    with kernels_alone(), ThreadPoolExecutor(workers, "shared", torch.set_num_threads, (1,)) as pool:
        try:
            for item in items:
                under_way.append(pool.submit(copy_context().run, alone, item))
                if len(under_way) > workers:
                    yield under_way.popleft().result()
            while under_way:
                yield under_way.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def addresses(*tensors: Tensor | None) -> ctypes.Array:
    """Return the addresses of contiguous tensors, null for None, as a C array."""
    return (ctypes.c_void_p * len(tensors))(*(Address.from_param(t) for t in tensors))


def fits(*tensors: Tensor) -> bool:
    """Return whether kernels can take all these tensors: float32 on the CPU."""
    import torch  # not above: matching and sweeping call kernels without it

    return all(t.dtype == torch.float32 and t.device.type == "cpu" for t in tensors)
