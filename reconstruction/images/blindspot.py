"""Blind-spot network: learns from spikes alone, so also from a recording whose true light nobody knows.

Order: as Spk2ImgNet, a little less sharp; it has learnt to guess each pixel's interval from its neighbours and from the
pixel's own past and future, and joins the guess with the interval as far as their errors tell. The weights that ship
come from the spikes of random scenes; `python -m reconstruction.images.learned.train own REC --out DIR` trains on REC.
Cost: about a second a core at 400x250. Sources: `reconstruction.images.learned.blind`.
"""

from pathlib import Path

from acquisition.spikes.stream import SpikeStream
from reconstruction.images.estimate import Estimate


def blindspot(stream: SpikeStream, plane: int, weights: Path | None = None) -> Estimate:
    """Image at `plane`; valid where a pixel or its neighbour ever fired near the instant. `weights`: one's own."""
    from reconstruction.images.learned.inference import estimated  # torch, which no other method needs

    return estimated("blindspot", stream, plane, weights)
