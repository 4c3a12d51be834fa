"""Tests that `look` finds the surface that takes half the light, not the mean of all that shines through."""

import numpy as np
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.scene_model import TimeSpan
from rigs.camera import Camera
from rigs.transform import Transform

CAMERA = Camera("cam11", 48, 40, 50.0, 48.0, 24.0, 20.0, Transform.identity())


def walls(*layers: tuple[float, float]) -> DynamicCloud:
    """Wide still Gaussians on the axis, by depth and opacity."""
    means = torch.tensor([[0.0, 0.0, z] for z, _ in layers])
    logits = torch.tensor([opacity for _, opacity in layers]).logit()
    quats = torch.tensor([[1.0, 0, 0, 0]]).repeat(len(layers), 1)
    still = GaussianCloud(means, quats, torch.full_like(means, 1.0), logits, torch.full((len(layers), 1), 0.3))
    nothing = still.select(torch.zeros(0, dtype=torch.long))
    return DynamicCloud(still, nothing, PolynomialMotion.at_rest(torch.zeros(0), 1.0), TimeSpan(0.0, 1.0))


def test_a_veil_before_a_wall_does_not_pull_its_depth_forward():
    view = walls((1.0, 0.3), (3.0, 0.9)).look(CAMERA, 0.5)
    assert np.isclose(view.depth[15:25, 19:29], 3.0).all()
    assert (view.intensity[15:25, 19:29] > 0.2).all()


def test_where_less_than_half_the_light_is_taken_there_is_no_depth():
    assert np.isnan(walls((1.0, 0.3), (3.0, 0.2)).look(CAMERA, 0.5).depth).all()
