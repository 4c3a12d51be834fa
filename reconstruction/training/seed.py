"""Points to the Gaussians training starts from."""

import numpy as np
import torch

from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import Clip, DynamicCloud, Motion
from reconstruction.initialization.points import Points

STILL_OPACITY = 0.7
MOVING_OPACITY = 0.6
WIDTH = 0.5  # of the gap to its neighbours: growing is quicker learnt than shrinking
LIFE = 1.0  # of the gap between the instants at which movers were swept
LARGEST_M = 0.25  # a lone point does not start as a cloud over everything


def seed_cloud(still: Points, moving: Points, clip: Clip, instants: int) -> DynamicCloud:
    """One Gaussian a point; `instants` is at how many moments of the clip movers were swept."""
    centers = torch.tensor([clip.fraction(s) for s in moving.instants_s], dtype=torch.float32)
    return DynamicCloud(
        _gaussians(still, STILL_OPACITY),
        _gaussians(moving, MOVING_OPACITY),
        Motion.at_rest(centers, duration=LIFE / instants),
        clip,
    )


def _gaussians(points: Points, opacity: float) -> GaussianCloud:
    count = len(points)
    scales = np.log(np.clip(WIDTH * points.spacing, 1e-5, LARGEST_M))
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1
    return GaussianCloud(
        means=torch.from_numpy(points.positions.astype(np.float32)),
        quats_wxyz=quats,
        log_scales=torch.from_numpy(np.repeat(scales[:, None], 3, axis=1).astype(np.float32)),
        opacity_logits=torch.full((count,), float(np.log(opacity / (1 - opacity)))),
        intensities=torch.from_numpy(points.intensities.astype(np.float32))[:, None],
    )
