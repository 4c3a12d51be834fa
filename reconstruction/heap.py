"""Keeps the memory small that the C library holds for a process; other libraries than glibc are left to themselves."""

import ctypes
import gc

_C = ctypes.CDLL(None)
_ARENA_MAX = -8  # of glibc's mallopt
HEAPS = 2


def share_heaps() -> None:
    """Let all threads share HEAPS heaps from now on.

    A thread has a heap of its own otherwise, which keeps what was freed even after the thread has ended.
    """
    if limit := getattr(_C, "mallopt", None):
        limit(_ARENA_MAX, HEAPS)


def give_back() -> None:
    """Give back what nothing holds any more."""
    gc.collect()  # closures hold one another, and with them images and planes
    if trim := getattr(_C, "malloc_trim", None):
        trim(0)
