"""Carries what one view sees into another along known depths. Letters: H rows, W columns."""

import cv2
import numpy as np
from numpy.typing import NDArray

from reconstruction.initialization.sweep import DepthMap, Image, back_project
from rigs.camera import Camera

VISIBLE = 0.02  # relative difference in depth up to which a neighbour sees the same surface


def sampled(wanted: Camera, depth: Image, image: Image, depth_map: DepthMap) -> tuple[Image, NDArray[np.bool_]]:
    """Return the pixels of `image` along the depth [H, W] of `wanted`, and where its view sees that very surface."""
    camera = depth_map.camera
    seen = camera.cam_from_rig.apply(back_project(wanted, np.nan_to_num(depth, nan=1.0)))
    z = np.maximum(seen[..., 2], 1e-6)
    x = (seen[..., 0] / z * camera.fx + camera.cx - 0.5).astype(np.float32)
    y = (seen[..., 1] / z * camera.fy + camera.cy - 0.5).astype(np.float32)
    found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    there = cv2.remap(depth_map.depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    with np.errstate(invalid="ignore"):
        visible = np.abs(there / z - 1) < VISIBLE
    return np.asarray(found, np.float32), visible & np.isfinite(depth)
