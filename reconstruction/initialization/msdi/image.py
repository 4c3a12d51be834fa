"""MSDI's image network on a single stream: Spk2ImgNet's small tier as it was learnt on beside the geometry.

Order and cost are those of `reconstruction.images.spk2imgnet`, whose weights it started from. Source: see `network`.
"""

from pathlib import Path

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.estimate import Estimate
from reconstruction.images.learned.inference import estimated_by
from reconstruction.images.learned.models import model
from reconstruction.initialization.msdi.shipped import trained


def msdi(stream: SpikeStream, plane: int, weights: Path | None = None) -> Estimate:
    """Image at `plane`; valid where a pixel or its neighbour ever fired near the instant. `weights` are one's own."""
    return estimated_by(model("small"), trained(weights).image, stream, plane)
