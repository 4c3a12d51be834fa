"""The native library of this package."""

import ctypes

from acquisition.native import load_library


def library() -> ctypes.CDLL:
    """The native kernels of `reconstruction`, built for this processor."""
    return load_library("reconstruction")
