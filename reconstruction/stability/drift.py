"""Defines case 26 at length: a sensor, its counts and the rig clock over ten million ticks, against whole numbers.

Letters: q the charge of one tick in units of 2^-40 spike, Q what has been added since the start, n the spikes since. A
pixel that starts with the charge c and loses nothing has n = floor(c + Q), so that n - Q stays within (c - 1, c].
"""

import copy
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import FRACTION_BITS, Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.probe import natives, running
from reconstruction.stability.recordings import ticks_off
from rigs.clock import RigClock

CHUNK = 100_000  # ticks exposed at a time
LIGHTS = np.array([1e-6, 0.01, 1 / 3, 0.95], dtype=np.float32)  # brightest light of each column, in spikes per tick
SLOW = 70_000.0  # ticks to a radian of the swell of the light
REPLAYED = 200  # ticks that NumPy repeats after the kernel's
ROW = PlaneLayout(len(LIGHTS), 1)
TICK_RATE_HZ = 1e6 / 3  # makes a tick that is no finite binary fraction


def _light(first: int, last: int) -> NDArray[np.float32]:
    """Return the light of ticks [first, last) in spikes per tick [n, 1, W]."""
    swell = 0.75 + 0.25 * np.sin(np.arange(first, last) / SLOW)
    return (swell[:, None, None] * LIGHTS).astype(np.float32)


def _exposed(
    sensor: Sensor, ticks: int, progress: Progress, what: str
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.uint8]]]:
    """Yield the light and the spikes [n, 1, W] of all ticks, some at a time."""
    for first in range(0, ticks, CHUNK):
        light = _light(first, min(ticks, first + CHUNK))
        yield light, sensor.expose(light)
        progress(first / ticks, f"{first:,} ticks of {what}")


def _unlike_its_twin(sensor: Sensor, ticks: int) -> int:
    """Return how many bits of the next ticks differ between the kernel and NumPy."""
    twin, light = copy.deepcopy(sensor), _light(ticks, ticks + REPLAYED)
    return int((sensor.expose(light) != twin.expose_reference(light)).sum())


def _charge(renderer: str, ticks: int, progress: Progress) -> Observation:
    """Compare the spikes with the charge, then count all of them from the file they make."""
    sensor, total = Sensor(len(LIGHTS), 1, "ideal", 7, 0), np.zeros(len(LIGHTS), dtype=np.int64)
    balance = np.zeros((1, len(LIGHTS)), dtype=np.int64)  # n - Q of the last ticks, in whole numbers
    low = high = balance[-1]
    with running(renderer), tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "long.dat"
        with file.open("wb") as out:
            for light, spikes in _exposed(sensor, ticks, progress, f"a sensor, {renderer}"):
                charge = (light[:, 0].astype(np.float64) * 2.0**FRACTION_BITS + 0.5).astype(np.int64)
                balance = balance[-1] + np.cumsum((spikes[:, 0].astype(np.int64) << FRACTION_BITS) - charge, axis=0)
                low, high = np.minimum(low, balance.min(axis=0)), np.maximum(high, balance.max(axis=0))
                total += spikes[:, 0].sum(axis=0, dtype=np.int64)
                out.write(pack(spikes, ROW).tobytes())
        stream = SpikeStream.open(file, ROW, TICK_RATE_HZ)
        wrong = int((stream.counts(0, ticks)[0] != total).sum()) + (sensor.tick != ticks)
        del stream
        wrong += _unlike_its_twin(sensor, ticks)
    span = float((high - low).max()) / 2.0**FRACTION_BITS
    said = f"{int(total.sum()):,} spikes, spikes less charge within {span:.6f}, {wrong} counts or bits wrong"
    return Observation(said, max(0.0, span - 1) + wrong)


def _noise(renderer: str, ticks: int, progress: Progress) -> Observation:
    """Compare the kernel of a noisy sensor with its twin after all ticks."""
    sensor = Sensor(len(LIGHTS), 1, "real", 7, 0)
    with running(renderer):
        spikes = sum(int(s.sum()) for _, s in _exposed(sensor, ticks, progress, f"a noisy sensor, {renderer}"))
        differing = _unlike_its_twin(sensor, ticks)
    return Observation(f"{spikes:,} spikes; of the next {REPLAYED} ticks {differing} bits differ", float(differing))


def _clock(ticks: int, progress: Progress) -> Observation:
    """Take every tick to its instant and back, and compare every 97th with rational numbers."""
    clock = RigClock(TICK_RATE_HZ)
    wrong, error = 0, 0.0
    for first in range(0, ticks, CHUNK):
        progress(first / ticks, f"{first:,} ticks of the clock")
        last = min(ticks, first + CHUNK)
        wrong += sum(clock.plane(clock.instant_s(plane)) != plane for plane in range(first, last))
        error = max(error, *(ticks_off(clock, plane) for plane in range(first, last, 97)))
    return Observation(f"{wrong} of {ticks:,} in another plane, {error:.0e} ticks off", error + wrong)


def drift_cases(ticks: int, progress: Progress) -> tuple[Case, ...]:
    """Return the cases over so many ticks; each reports its own progress from 0 to 1."""
    balanced, alike = "spikes less charge within one spike", "as its twin in NumPy"
    return (
        Case(26, f"{ticks:,} ticks of a sensor", balanced, 0.0, lambda on: _charge(on, ticks, progress), natives),
        Case(26, f"{ticks:,} ticks with noise", alike, 0.0, lambda on: _noise(on, ticks, progress), natives),
        Case(26, f"{ticks:,} ticks of the clock", "as in rational numbers", 1e-6, lambda _: _clock(ticks, progress)),
    )
