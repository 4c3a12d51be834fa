"""What can be trained: Gaussians, or a radiance field."""

from __future__ import annotations

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.radiance_fields.field import KIND, RadianceField

Model = DynamicCloud | RadianceField


def model_from_state(state: dict) -> Model:
    """The inverse of `state` of either; raises ReconstructionError for a model or tensors nobody knows."""
    return (RadianceField if state.get("model") == KIND else DynamicCloud).from_state(state)
