"""The state of a training on disk, and the model in it."""

from pathlib import Path

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.radiance_fields.radiance_field import RadianceField
from reconstruction.scene_model import SceneModel
from reconstruction.tensors import read_tensors


def load_checkpoint(path: Path) -> dict:
    """Read a checkpoint or snapshot; raises BadRunError for a missing or damaged file."""
    return read_tensors(path, "one of a trained run", "run the train stage again")


def model_from_state(state: dict) -> SceneModel:
    """Return the model whose `state` this is; raises ReconstructionError for a kind or tensors nobody knows."""
    kinds = {RadianceField.kind: RadianceField, SpannedScene.kind: SpannedScene}
    return kinds.get(state.get("model", ""), DynamicCloud).from_state(state)


def load_cloud(path: Path) -> SceneModel:
    """Read the model of a checkpoint or snapshot."""
    return model_from_state(load_checkpoint(path)["cloud"])
