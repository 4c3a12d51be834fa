"""Pixel calibration: what a flat and a dark recording say of each pixel, and images corrected by it.

A pixel fires gain * light + offset spikes per tick. The offset is its rate in the dark, the gain its rate under even
light above that, with a mean of 1 over the good pixels; so light that is not even goes into the gain. Counts of T
planes leave errors of about 0.4 / T in the offset and 0.4 / (T * light) in the gain.
"""

import io
import zlib
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import read_arrays
from acquisition.durable import write_durably
from acquisition.errors import BadRecordingError
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.mending import mended

LEAST_SPIKES = 200  # a pixel, of the light alone: its gain to 0.2 %
BRIGHTEST = 0.95  # spikes per tick; pixels fire at most once a tick
SATURATED, MOST_SATURATED = 0.99, 0.001  # spikes per tick, and the most pixels, as a share, that may reach it
DIM_IT = "pixels saturate; dim the light"
HOT_ABOVE, HOT_SPREADS = 0.02, 8.0  # spikes per tick, or robust standard deviations, above the median in the dark
DEAD_BELOW = 0.2  # light of a dead pixel, as a share of the median
_NO_ARCHIVE = (ValueError, KeyError, TypeError, AttributeError, EOFError, NotImplementedError, BadZipFile, zlib.error)
_ARRAYS = ("gain", "offset", "hot", "dead")


@dataclass(frozen=True, eq=False)
class PixelCalibration:
    """`gain` (mean 1) and `offset` in spikes per tick, float32 [H, W]; `hot` and `dead` [H, W] are of no use."""

    gain: NDArray[np.float32]
    offset: NDArray[np.float32]
    hot: NDArray[np.bool_]
    dead: NDArray[np.bool_]

    def __post_init__(self) -> None:
        arrays = [getattr(self, name) for name in _ARRAYS]
        if len({array.shape for array in arrays}) > 1 or self.gain.ndim != 2:
            raise BadRecordingError(f"found pixel maps of {[array.shape for array in arrays]}", "one size")
        if not (np.isfinite(self.gain).all() and np.isfinite(self.offset).all() and (self.gain > 0).all()):
            raise BadRecordingError("found a gain or offset that is not finite or not positive", "numbers")

    @property
    def defect(self) -> NDArray[np.bool_]:
        """Return which pixels [H, W] are hot or dead."""
        return self.hot | self.dead

    def corrected(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Even out an image [H, W] in spikes per tick; defects take the median of their good neighbours."""
        if image.shape != self.gain.shape:
            raise BadRecordingError(f"found an image of {image.shape}", f"{self.gain.shape} as calibrated")
        even = np.maximum((image - self.offset) / self.gain, 0).astype(np.float32)
        return mended(even, self.defect)


def estimate_pixels(flat: SpikeStream, dark: SpikeStream) -> PixelCalibration:
    """Estimate the calibration of one camera from planes under even light and planes without light.

    Raises BadRecordingError where they differ in size, or the light is too little or too much to tell pixels apart.
    """
    sizes = [f"{stream.layout.width}x{stream.layout.height}" for stream in (flat, dark)]
    if sizes[0] != sizes[1]:
        raise BadRecordingError(f"found a flat of {sizes[0]} and a dark of {sizes[1]}", "one size")
    lit, unlit = _rate(flat), _rate(dark)
    light = lit - unlit
    if (spikes := float(np.median(light)) * len(flat)) < LEAST_SPIKES:
        found = f"found {max(0.0, spikes):.0f} spikes a pixel of light in {len(flat)} planes of the flat"
        raise BadRecordingError(found, f"at least {LEAST_SPIKES}", "give it more light or record longer")
    if (brightest := float(np.median(lit))) > BRIGHTEST:
        found = f"found {brightest:.2f} spikes per tick in the flat"
        raise BadRecordingError(found, f"at most {BRIGHTEST}", DIM_IT)
    spread = 1.4826 * float(np.median(np.abs(unlit - np.median(unlit))))
    hot = unlit > np.median(unlit) + max(HOT_ABOVE, HOT_SPREADS * spread)
    if (share := float((lit[~hot] > SATURATED).mean())) > MOST_SATURATED:
        found = f"found {share:.1%} of the pixels firing in nearly every tick of the flat"
        raise BadRecordingError(found, f"at most {MOST_SATURATED:.1%}", DIM_IT)
    dead = ~hot & (light < DEAD_BELOW * np.median(light))
    good = ~(hot | dead)
    gain = np.where(good, light / light[good].mean(), 1.0)
    return PixelCalibration(gain.astype(np.float32), unlit.astype(np.float32), hot, dead)


def write_pixels(path: Path, calibration: PixelCalibration) -> None:
    """Write the calibration to `path` as .npz, durably."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{name: getattr(calibration, name) for name in _ARRAYS})
    write_durably(path, buffer.getvalue())


def read_pixels(path: Path) -> PixelCalibration:
    """Read what `write_pixels` wrote; raises BadRecordingError naming the file for anything else."""
    try:
        arrays = read_arrays(path)
        gain, offset, hot, dead = (arrays[name] for name in _ARRAYS)
        return PixelCalibration(gain.astype(np.float32), offset.astype(np.float32), hot.astype(bool), dead.astype(bool))
    except OSError as error:
        raise BadRecordingError(f"cannot be read ({error.strerror})", do="calibrate again", where=path) from error
    except (*_NO_ARCHIVE, BadRecordingError) as error:
        raise BadRecordingError(f"found no pixel calibration ({error})", do="calibrate again", where=path) from error


def _rate(stream: SpikeStream) -> NDArray[np.float64]:
    return stream.counts(0, len(stream)) / len(stream)
