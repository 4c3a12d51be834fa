"""Defines cases 22 to 25 and 27 for every image method without weights: pixels and clips at their limits.

Light is exact: each pixel fires at a fixed period. Each method runs by every code path of the kernels, whose images
must be the same to the bit.
"""

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.native import code_path, code_paths
from acquisition.spikes.layout import BitOrder, PlaneLayout, RowOrder
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import stuck_pixels
from reconstruction.images.catalogue import Estimate, methods
from reconstruction.images.mending import mended
from reconstruction.images.pixels import estimate_pixels
from reconstruction.stability.case import Case, Observation

SIZE = (12, 17)  # rows, columns: 204 bits are no whole bytes
MIDDLE, PLANES = 150, 301
PERIODS = (2, 3, 4, 5)  # ticks to a spike, by column
SHORTEST = 33  # planes that a method looks at where nothing moves, at least
COARSEST = 0.4  # sigma of a single interval of one tick, in spikes per tick
ORDERS: tuple[tuple[BitOrder, RowOrder], ...] = (("lsb", "bottom"), ("msb", "top"))


def method_names() -> tuple[str, ...]:
    """Return the methods that need no weights."""
    return tuple(m.name for m in methods().values() if not m.learned)


def _periods() -> NDArray[np.int64]:
    return np.resize(PERIODS, SIZE)


def _spikes(periods: NDArray[np.int64], planes: int = PLANES) -> NDArray[np.uint8]:
    """Return planes [T, H, W] of pixels that fire once a period [H, W] in ticks, each in its own phase; 0 is never."""
    phases = np.arange(periods.size).reshape(periods.shape) * 7
    ticks = np.arange(planes)[:, None, None]
    return ((periods > 0) & ((ticks + phases) % np.maximum(periods, 1) == 0)).astype(np.uint8)


def _stream(spikes: NDArray[np.uint8], bit_order: BitOrder = "lsb", row_order: RowOrder = "bottom") -> SpikeStream:
    layout = PlaneLayout(spikes.shape[2], spikes.shape[1], bit_order, row_order)
    return SpikeStream(pack(spikes, layout), layout, 20000.0)


def _image(name: str, stream: SpikeStream, plane: int = MIDDLE) -> Estimate:
    """Return the estimate if it is the same by every code path, else one that is not finite."""
    found = []
    for path in code_paths():
        with code_path(path):
            found.append(methods()[name](stream, plane))
    alike = all(np.array_equal(e.intensity, found[0].intensity) for e in found)
    return found[0] if alike else Estimate(found[0].intensity * np.nan, found[0].valid, found[0].sigma)


def _light_error(estimate: Estimate, periods: NDArray[np.int64]) -> float:
    """Return the largest error beyond three of the claimed standard deviations, in spikes per tick."""
    gap = np.abs(estimate.intensity - 1 / periods) - 3 * estimate.sigma
    return math.inf if not np.isfinite(gap).all() else max(0.0, float(gap.max()))


def _patched(name: str, period: int) -> tuple[Estimate, float]:
    """Return the estimate of a patch whose pixels have that period, and the error of the pixels around it."""
    periods, patch = _periods(), np.zeros(SIZE, dtype=bool)
    patch[4:6, 6:9] = True
    found = _image(name, _stream(_spikes(np.where(patch, period, periods))))
    own, around = (Estimate(found.intensity[w], found.valid[w], found.sigma[w]) for w in (patch, ~patch))
    return own, _light_error(around, periods[~patch])


def _silent(name: str) -> Observation:
    own, lit = _patched(name, 0)
    most, flagged = float(own.intensity.max()), not own.valid.any()
    said = f"{'flagged' if flagged else 'not flagged'}, at most {most:.4f}; the others {lit:.0e} off"
    return Observation(said, max(lit, most - 1 / SHORTEST) if flagged else math.inf)


def _saturated(name: str) -> Observation:
    own, lit = _patched(name, 1)
    least, surest, flagged = float(own.intensity.min()), float(own.sigma.min()), not own.valid.any()
    said = f"{least:.4f} at least, {'flagged' if flagged else f'as unsure as {surest:.2f}'}; the others {lit:.0e} off"
    return Observation(said, max(lit, 1 - least) if flagged or surest >= COARSEST else math.inf)


def _defects(name: str) -> Observation:
    """Find dead and stuck pixels in the whole clip, and mask them in the image of its middle."""
    periods, defect = _periods(), np.zeros(SIZE, dtype=bool)
    broken = periods.copy()
    for row, column, period in ((3, 4, 0), (3, 11, 1), (8, 4, 1), (8, 11, 0), (0, 0, 0), (11, 16, 1)):
        broken[row, column], defect[row, column] = period, True
    stream = _stream(_spikes(broken))
    found = stuck_pixels(stream.counts(0, PLANES).astype(np.float32) / np.float32(PLANES))
    image = mended(_image(name, stream).intensity, found)
    clean = _image(name, _stream(_spikes(periods)))
    return _masked(image, clean.intensity, defect, int((found != defect).sum()))


def _masked(
    image: NDArray[np.float32], light: NDArray[np.float32], defect: NDArray[np.bool_], missed: int
) -> Observation:
    """Compare an image with the light around its defects; at these it must lie within the range of the light."""
    changed = float(np.abs(image - light)[~defect].max())
    filled = bool(((image >= light.min()) & (image <= light.max()))[defect].all())
    said = f"{missed} of {int(defect.sum())} missed or made up, neighbours {changed:.0e} off"
    return Observation(said, changed if filled and not missed else math.inf)


def _calibrated(_: str) -> Observation:
    """Find hot and dead pixels in a flat and a dark recording, and mask them in an image of another light."""
    hot, dead = np.zeros(SIZE, dtype=bool), np.zeros(SIZE, dtype=bool)
    hot[3, 4], hot[8, 11], dead[3, 11], dead[8, 4] = True, True, True, True
    dark = np.where(hot, 3, 0)
    flat = np.where(dead, 0, np.where(hot, 1, 2))
    found = estimate_pixels(_stream(_spikes(flat, 600)), _stream(_spikes(dark, 600)))
    light = (1 / _periods()).astype(np.float32)
    seen = np.where(hot, light + np.float32(1 / 3), np.where(dead, np.float32(0), light))
    missed = int((found.hot != hot).sum() + (found.dead != dead).sum())
    return _masked(found.corrected(seen), light, hot | dead, missed)


def _short(name: str) -> Observation:
    """Look at a clip of one plane, and at one of nine with a spike in its middle: at most a spike in four ticks."""
    error, said = 0.0, []
    for planes, at, bound in ((1, 0, 1.0), (9, 6, 1 / 4)):
        spikes = np.zeros((planes, *SIZE), dtype=np.uint8)
        spikes[planes // 2] = 1
        found = _image(name, _stream(spikes), at)
        whole = found.valid.any() and planes == 1
        sane = bool(np.isfinite(found.intensity).all() and np.isfinite(found.sigma).all() and (found.sigma > 0).all())
        most = float(found.intensity.max())
        said.append(f"{most:.2f} of {planes} {'not flagged' if found.valid.any() else 'flagged'}")
        error = max(error, most - bound) if sane and not whole else math.inf
    return Observation(", ".join(said), error)


def _odd_sizes(name: str) -> Observation:
    """Compare every size and order of bits with the same pixels in a corner of whole bytes, silent elsewhere."""
    differing, count = 0, 0
    for height, width in (SIZE, (1, 1), (3, 5), (7, 8)):
        for planes in (301, 1, 15):
            spikes = _spikes(_periods()[:height, :width], planes)
            room = np.zeros((planes, 16, 32), dtype=np.uint8)
            room[:, :height, :width] = spikes
            wanted = _image(name, _stream(room), planes // 2).intensity[:height, :width]
            for order in ORDERS:
                found = _image(name, _stream(spikes, *order), planes // 2).intensity
                differing += int((found != wanted).sum())
                count += 1
    return Observation(f"{differing} pixels of {count} images differ", float(differing))


CASES = (
    Case(22, "pixels that never fire", "flagged, no brighter than the silence", 1e-3, _silent, method_names),
    Case(23, "pixels that always fire", "1 at least, flagged or that unsure", 1e-3, _saturated, method_names),
    Case(24, "dead and stuck pixels", "masked, neighbours unchanged", 0.0, _defects, method_names),
    Case(24, "hot and dead pixels", "masked, neighbours unchanged", 1e-6, _calibrated),
    Case(25, "a clip below an interval, one plane", "a bound; one plane flagged", 0.0, _short, method_names),
    Case(27, "sizes of no whole bytes", "the same to the bit", 0.0, _odd_sizes, method_names),
)
