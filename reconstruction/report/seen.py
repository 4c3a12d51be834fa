"""Shows what a camera saw, beside renders of the scene; needs no torch and no OpenCV, so that the web process may."""

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import method
from reconstruction.report.display import Pixels, grey

SEEN_BY = "adaptive"  # the best by tests/benchmarks/images.json of those that need no learned network


def seen(stream: SpikeStream, plane: int, white: float) -> Pixels:
    """Return what a camera saw at `plane`, by its spikes, in grey [H, W]; `white` (spikes a tick) is shown white."""
    return grey(method(SEEN_BY)(stream, plane).intensity, white)
