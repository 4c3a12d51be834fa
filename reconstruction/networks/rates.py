"""The input of the image networks: light in windows around an instant, read off the spikes' own times.

Letters: T planes, H rows, W columns, e edges. A pixel's charge grows by one from spike to spike; between two spikes it
is taken to grow evenly, so the charge at any time is known to a fraction of a spike, and its growth over a window is a
rate without the whole spikes that a count rounds to. This is what TFI does at an instant, for windows of any length.
"""

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream

Floats = NDArray[np.float32]
HALF_WIDTHS = (2, 5, 9, 14, 20, 28, 40, 64)  # ticks from the instant to the edges of the bins
REACH, RAW_REACH = HALF_WIDTHS[-1], 20  # planes to either side, of the rates and of the raw planes
EDGES = np.array([-h for h in reversed(HALF_WIDTHS)] + list(HALF_WIDTHS))
BINS = len(EDGES) - 1


def planes_around(stream: SpikeStream, plane: int, reach: int) -> NDArray[np.uint8]:
    """Return planes [2 reach + 1, H, W] centred on `plane`; beyond its ends the stream is mirrored."""
    first, last = stream.around(plane, reach)
    seen = stream.planes(first, last)
    missing = (reach - (plane - first), reach + 1 - (last - plane))
    return np.pad(seen, (missing, (0, 0), (0, 0)), mode="symmetric") if any(missing) else seen


def charge(planes: NDArray[np.uint8], ticks: NDArray[np.int_]) -> Floats:
    """Return the spikes, with a fraction, that pixels of `planes` [T, H, W] gathered up to the middle of `ticks` [e].

    Before its first and after its last spike a pixel keeps its mean rate, but no more than its silence allows.
    """
    total = len(planes)
    count = np.cumsum(planes, axis=0, dtype=np.uint16)
    order = np.arange(1, total + 1, dtype=np.uint16)[:, None, None]
    before = np.maximum.accumulate(planes * order, axis=0)  # plane of the last spike so far, from 1; 0: none
    after = total + 1 - np.maximum.accumulate((planes * (total + 1 - order))[::-1], axis=0)[::-1]  # of the next one
    first, last, spikes = after[0].astype(np.float32), before[-1].astype(np.float32), count[-1].astype(np.float32)
    rate = np.where(spikes > 1, (spikes - 1) / np.maximum(last - first, 1), np.float32(1 / total))
    lead, trail = np.minimum(rate, 1 / first), np.minimum(rate, 1 / (total + 1 - last))
    out = np.empty((len(ticks), *planes.shape[1:]), dtype=np.float32)
    for k, tick in enumerate(ticks):
        now, past = np.float32(tick + 1), before[tick].astype(np.float32)
        ahead = after[tick + 1].astype(np.float32) if tick + 1 < total else np.full_like(past, total + 1)
        between = count[tick] + (now - past) / (ahead - past)
        early, late = 1 - lead * (first - now), spikes + trail * (now - last)
        out[k] = np.where(past == 0, early, np.where(ahead > total, late, between))
    return np.where(spikes > 0, out, 0)


def rates(stream: SpikeStream, plane: int) -> Floats:
    """Return the mean light [BINS, H, W] in spikes per tick between the bins' edges around the instant at `plane`."""
    return bin_rates(charge(planes_around(stream, plane, REACH), EDGES + REACH))


def bin_rates(gathered: Floats) -> Floats:
    """Return the rates [BINS, H, W] between the edges from the charge [BINS + 1, H, W] at them."""
    return np.diff(gathered, axis=0) / np.diff(EDGES).astype(np.float32)[:, None, None]
