"""A recording that cameras are looked for in, and where they truly stand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from reconstruction.calibration.features import long_image
from reconstruction.evaluation.truth import Truth
from rigs.rig import Rig


@dataclass(frozen=True)
class PoseClip:
    """A simulated recording and its truth."""

    scene: str
    seed: int
    path: Path

    @cached_property
    def recording(self) -> Recording:
        """The recording."""
        return Recording.open(self.path)

    @cached_property
    def truth(self) -> Truth:
        """Its truth."""
        assert self.recording.truth is not None
        return Truth.open(self.recording.truth)

    @cached_property
    def rig(self) -> Rig:
        """The cameras as they truly stand."""
        found = self.truth.cameras(self.recording.tick_rate_hz)
        assert found is not None
        return found.only(self.recording.camera_ids)

    @cached_property
    def long_images(self) -> dict[str, NDArray[np.float32]]:
        """The long-window image of every camera, for scoring."""
        return {c: long_image(self.recording.stream(c)) for c in self.recording.camera_ids}
