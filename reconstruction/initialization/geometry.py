"""What an initialiser finds out about a recording: where the cameras stand, and what it saw of the scene on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rigs.rig import Rig


@dataclass(frozen=True, eq=False)
class Geometry:
    """Cameras in the rig frame, points in it with their confidence, and an image of each view at one instant.

    `rig` has every camera that was given, aligned by similarity to the rig that was given. `points` [N, 3] in m with
    `confidence` [N] > 0 (larger is better) and `images` (camera id to [H, W], spikes per tick) are empty where the
    method has none. `report` holds plain values for `run.json`: what was found, what was refused, and why.
    """

    rig: Rig
    points: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    confidence: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    images: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    report: Mapping[str, object] = field(default_factory=dict)
