"""State of a training on disk: tensors and numbers only, loaded without running code."""

import io
import pickle
from pathlib import Path

import torch

from acquisition.durable import write_durably
from reconstruction.errors import BadRunError
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.radiance_fields.radiance_field import RadianceField
from reconstruction.scene_model import SceneModel


def save_checkpoint(path: Path, state: dict) -> None:
    """Write `state` (tensors, numbers, strings, nested) durably under `path`."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, buffer.getvalue())


def load_checkpoint(path: Path) -> dict:
    """Read what `save_checkpoint` wrote; raises BadRunError for a missing or damaged file."""
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise BadRunError("not found", "a trained run", "run the train stage first", where=path) from error
    except (RuntimeError, EOFError, pickle.UnpicklingError, ValueError) as error:
        raise BadRunError("found a damaged checkpoint", "one of this version", "train again", where=path) from error


def model_from_state(state: dict) -> SceneModel:
    """Return the model whose `state` this is; raises ReconstructionError for a kind or tensors nobody knows."""
    return (RadianceField if state.get("model") == RadianceField.kind else DynamicCloud).from_state(state)


def load_cloud(path: Path) -> SceneModel:
    """Read the model of a checkpoint or snapshot."""
    return model_from_state(load_checkpoint(path)["cloud"])
