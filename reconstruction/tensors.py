"""Tensors on disk: files that are whole or absent, and are read without running anything that they say."""

import io
import pickle
import struct
from pathlib import Path
from zipfile import BadZipFile

import torch

from acquisition.durable import write_durably
from reconstruction.errors import BadRunError

_UNREADABLE = (
    *(OSError, RuntimeError, EOFError, pickle.UnpicklingError, ValueError, TypeError, LookupError, AttributeError),
    *(struct.error, BadZipFile, ImportError, AssertionError, ArithmeticError, MemoryError),
)


def write_tensors(path: Path, state: dict) -> None:
    """Write `state` (tensors, numbers, strings, nested) under `path`, whose folder is made if need be."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, buffer.getvalue())


def read_tensors(path: Path, expected: str, do: str) -> dict:
    """Read what `write_tensors` wrote; raises BadRunError for a missing or damaged file, with `expected` and `do`."""
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise BadRunError("found no such file", expected, do, where=path) from None
    except _UNREADABLE as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise BadRunError(f"found no readable checkpoint ({reason})", expected, do, where=path) from error
