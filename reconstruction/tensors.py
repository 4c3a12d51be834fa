"""Tensors on disk: states, and weights in half precision as .npz.

Files are whole or absent, and are read without running anything that they say.
"""

import io
import pickle
import struct
import zlib
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch
from torch import Tensor, nn

from acquisition.arrays import read_arrays
from acquisition.durable import write_durably
from reconstruction.errors import BadRunError

_UNREADABLE = (
    *(OSError, RuntimeError, EOFError, pickle.UnpicklingError, ValueError, TypeError, LookupError, AttributeError),
    *(struct.error, BadZipFile, ImportError, AssertionError, ArithmeticError, MemoryError),
)


def write_tensors(path: Path, state: dict) -> None:
    """Write `state` (tensors, numbers, strings, nested) under `path`, whose folder is made if need be.

    Its tensors are written as tensors on the CPU, wherever they are.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, packed(state))


def packed(state: dict) -> bytes:
    """Return what `write_tensors` writes of `state`."""
    buffer = io.BytesIO()
    torch.save(on_cpu(state), buffer)
    return buffer.getvalue()


def read_tensors(path: Path, expected: str, do: str) -> dict:
    """Read what `write_tensors` wrote; raises BadRunError for a missing or damaged file, with `expected` and `do`."""
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise BadRunError("found no such file", expected, do, where=path) from None
    except _UNREADABLE as error:
        raise BadRunError(f"found no readable checkpoint ({_reason(error)})", expected, do, where=path) from error


def on_cpu(state: Any) -> Any:
    """Return `state` with all tensors, nested in dictionaries, lists and tuples, on the CPU."""
    if isinstance(state, Tensor):
        return state.cpu()
    if isinstance(state, dict):
        return {key: on_cpu(value) for key, value in state.items()}
    return type(state)(map(on_cpu, state)) if isinstance(state, list | tuple) else state


def write_weights(path: Path, state: dict[str, Tensor]) -> None:
    """Write the tensors of a module to `path` in half precision; raises BadRunError for one it cannot hold."""
    arrays = {name: tensor.detach().half().cpu().numpy() for name, tensor in state.items()}
    spoilt = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if spoilt:
        raise BadRunError(f"found weights that are not finite in half precision: {', '.join(spoilt)}", do="train again")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    write_durably(path, buffer.getvalue())


def read_weights(path: Path, module: nn.Module) -> None:
    """Fill `module` from what `write_weights` wrote; raises BadRunError for a missing, damaged or other file."""
    try:
        state = {name: torch.from_numpy(array.astype(np.float32)) for name, array in read_arrays(path).items()}
        module.load_state_dict(state)
    except OSError as error:
        raise BadRunError(f"found no weights ({error.strerror})", do="train this network first", where=path) from error
    except (*_UNREADABLE, zlib.error) as error:
        found = f"found other or damaged weights ({_reason(error)})"
        raise BadRunError(found, do="train this network again", where=path) from error


def _reason(error: Exception) -> str:
    """Return the first line of an error's message, or its kind."""
    return (str(error).splitlines() or [type(error).__name__])[0][:120]
