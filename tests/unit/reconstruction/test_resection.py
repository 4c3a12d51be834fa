"""A camera that nobody trained on is placed by its own light, from twenty pixels away."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from reconstruction.evaluation.resection import Counted, resected
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.scene_model import TimeSpan
from rigs.camera import Camera
from rigs.transform import Transform

W, H, F = 128, 96, 130.0
TRUE = Camera("cam11", W, H, F, F, W / 2, H / 2, Transform.looking_at((0.1, -0.05, 0.0), (0.0, 0.0, 2.0)))


@pytest.fixture(scope="module")
def model():
    """A textured relief, 1.6 to 2.4 m away."""
    rng = np.random.default_rng(0)
    picture = cv2.GaussianBlur(rng.random((256, 256)).astype(np.float32), (0, 0), 9)
    picture = (picture - picture.min()) / np.ptp(picture)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1.6, 1.6, 110), np.linspace(-1.2, 1.2, 84)))
    z = 2 + 0.4 * np.sin(3 * x) * np.cos(2 * y)
    light = picture[(60 * y + 128).astype(int), (60 * x + 128).astype(int)]
    points = torch.tensor(np.stack([x, y, z], axis=1), dtype=torch.float32)
    still = GaussianCloud.from_points(points, torch.tensor(light)[:, None], torch.full((len(x),), 0.016).log(), 0.95)
    none = still.select(torch.arange(0))
    return DynamicCloud(still, none, PolynomialMotion.at_rest(torch.zeros(0), 1.0), TimeSpan(0.0, 0.01))


def seen(model):
    rng = np.random.default_rng(1)
    light = model.look(TRUE, 0.005).intensity
    return [Counted(0.005, (light + rng.normal(0, 0.01, light.shape)).astype(np.float32))]


def off(camera):
    """Degrees and metres from the true place."""
    between = camera.cam_from_rig @ TRUE.cam_from_rig.inverse()
    angle = np.degrees(np.arccos(np.clip((np.trace(between.rotation) - 1) / 2, -1, 1)))
    return angle, float(np.linalg.norm(camera.center - TRUE.center))


@pytest.mark.parametrize(
    ("turn_deg", "shift_m"), [((0, 0, 0), (0, 0, 0)), ((4, 6, 3), (0.02, -0.03, 0.04)), ((-5, 7, -4), (0.05, 0.05, 0))]
)
def test_a_camera_far_off_is_placed(model, turn_deg, shift_m):
    begun = replace(TRUE, cam_from_rig=Transform.from_rotvec(np.radians(turn_deg), shift_m) @ TRUE.cam_from_rig)
    found = resected(model, begun, seen(model))
    angle, metres = off(found)
    assert angle < 0.1
    assert metres < 0.005
    assert (found.fx, found.fy, found.cx, found.cy) == (TRUE.fx, TRUE.fy, TRUE.cx, TRUE.cy)
