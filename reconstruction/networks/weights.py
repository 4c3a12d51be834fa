"""Weights as .npz in half precision, read without running code."""

import io
import zlib
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import torch
from torch import Tensor, nn

from acquisition.durable import write_durably
from reconstruction.errors import BadRunError

SHIPPED = Path(__file__).parent / "weights"


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
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            state = {name: torch.from_numpy(archive[name].astype(np.float32)) for name in archive.files}
        module.load_state_dict(state)
    except OSError as error:
        raise BadRunError(f"found no weights ({error.strerror})", do="train this network first", where=path) from error
    except (ValueError, KeyError, TypeError, AttributeError, RuntimeError, BadZipFile, zlib.error) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise BadRunError(f"found other or damaged weights ({reason})", do="train it again", where=path) from error
