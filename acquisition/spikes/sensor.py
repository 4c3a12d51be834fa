"""Simulates the integrate-and-fire sensor, which turns linear light into spike planes.

Letters: n planes, H rows, W columns. A pixel adds the light of each tick to its charge, fires at the threshold, keeps
what is above it, and fires at most once a tick; light above one spike per tick saturates. Charge is kept in units of
2^-40 spike, so ten million ticks lose nothing. At the start the charge is uniform below the threshold.
"""

import ctypes
import math
import os
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.native import Address, Kernel
from acquisition.spikes.readout import read_out
from acquisition.spikes.traits import DOUBLING_K, HARSH, HOT_LEVELS, PLAIN, Traits, draw_failures, spread_gain

SensorKind = Literal["ideal", "real", "harsh"]
SENSOR_KINDS: tuple[SensorKind, ...] = get_args(SensorKind)

FRACTION_BITS = 40  # bits of a spike in units of charge
_SPIKE = 2.0**FRACTION_BITS  # units
# SCSim (Hu et al., "SCSim: a realistic spike cameras simulator", ICME 2021) draws 5e4 electrons at full grey, which
# is about one spike a tick, and spreads the dark current by 39 %. Its gain spread of 5.8 % is that of an uncorrected
# sensor, and its threshold spread 4.5 % of the swing of 1.1 V; 1 % for both together is what a flat-field correction
# leaves. Thermal noise is that of a reset, sqrt(kT / C) of its 4.348 fF at 300 K, against the swing. The dark level and
# the defects are ours.
ELECTRONS_PER_SPIKE = 5e4
GAIN_SPREAD, THRESHOLD_SPREAD = 0.008, 0.006  # 0.01 together
THERMAL_NOISE = 8.9e-4  # of the threshold, standard deviation
DARK_LEVEL, DARK_SPREAD = 5e-4, 0.39  # spikes per tick, relative
DEFECT_SHARE = 1e-4  # share of the pixels that are dead, and of those that are hot

_TICK_STEP = np.uint64(0x9E3779B97F4A7C15)
_RESET_SALT = np.uint64(0xD6E8FEB86659FD93)
_GAINS, _FAILURES, _ROWS = range(3)  # draws of the traits, each by itself
_NORMAL_SCALE = 2.6428997921e-5  # 1 / standard deviation of the sum of four uniform 16-bit numbers
_EXPOSURE = (Address, ctypes.c_int64, ctypes.c_int64, Address, Address, ctypes.c_int32)
_NOISE = (*(Address,) * 5, ctypes.c_double, ctypes.c_double, ctypes.c_int64)
_expose = Kernel("acquisition", "sensor_real", *_EXPOSURE, *_NOISE)


def _mix(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Hash 64 bits to 64 bits by the finaliser of SplitMix64."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


class Sensor:
    """The pixels of one camera, whose charge `expose` carries on from call to call.

    The same `seed` and `camera_index` give the same planes for any `threads` (0: every core) and any cut into calls.
    The `ideal` sensor only integrates. The `real` one adds gain, dark current and threshold of each pixel, shot noise,
    thermal noise of each reset, and a few dead and hot pixels; the `harsh` one all of HARSH besides. `traits` come on
    top of any.
    """

    def __init__(
        self,
        width: int,
        height: int,
        kind: SensorKind,
        seed: int,
        camera_index: int,
        *,
        threads: int = 1,
        traits: Traits = PLAIN,
    ) -> None:
        if kind not in SENSOR_KINDS:
            raise BadRecordingError(f"found the sensor {kind!r}", f"one of {', '.join(SENSOR_KINDS)}")
        if width < 1 or height < 1 or seed < 0 or camera_index < 0:
            found = f"found a sensor of {width}x{height}, seed {seed}, camera {camera_index}"
            raise BadRecordingError(found, "1x1 or more, from 0")
        self.shape = (height, width)
        self.tick = 0  # of the next plane
        self._threads = threads or len(os.sched_getaffinity(0))
        pixels = np.arange(width * height, dtype=np.uint64)
        root = np.random.SeedSequence([seed, camera_index])
        self._keys = _mix(pixels * np.uint64(0xD1342543DE82EF95) + root.generate_state(1, np.uint64))
        self._charge = _mix(self._keys - _TICK_STEP) >> np.uint64(64 - FRACTION_BITS)
        if kind != "ideal":
            self._electrons, self._thermal = ELECTRONS_PER_SPIKE, THERMAL_NOISE * _SPIKE
            self._gain, self._dark, self._full = _fixed_pattern(np.random.default_rng(root), width * height)
        else:
            self._electrons, self._thermal = math.inf, 0.0
            self._gain, self._dark = np.ones(width * height), np.zeros(width * height)
            self._full = np.full(width * height, _SPIKE, dtype=np.uint64)
        self._limit = self._full.copy()
        self.traits = traits.over(HARSH if kind == "harsh" else PLAIN)
        self._take_on(self.traits, seed, camera_index)

    def _take_on(self, traits: Traits, seed: int, camera_index: int) -> None:
        rng = lambda draws: np.random.default_rng([seed, camera_index, 0x7A, draws])  # noqa: E731
        if traits.pixel_spread or traits.line_spread:
            self._gain *= spread_gain(rng(_GAINS), traits, self.shape)
        self._dark *= 2 ** (traits.warmer_k / DOUBLING_K)
        self.failures = draw_failures(rng(_FAILURES), traits, self._gain.size)
        self._row_keys = rng(_ROWS).integers(0, 2**64, self.shape[0], dtype=np.uint64)

    @property
    def response(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The gain and the rate in the dark, spikes per tick, that pixels [H, W] begin with."""
        full = self._full / _SPIKE
        gain, dark = (part.reshape(self.shape).astype(np.float32) for part in (self._gain / full, self._dark / full))
        return gain, dark

    def expose(self, intensity: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Return the planes [n, H, W] of 0 and 1 that light [n, H, W] in spikes per tick makes.

        The charge carries on to the next call. Negative light counts as none.
        Raises BadRecordingError for NaN or another shape.
        """
        light = self._read(intensity)
        spikes = np.empty(light.shape, dtype=np.uint8)
        first, last = self.tick, self.tick + len(light)
        cuts = [first, *self.failures.between(first, last), last]
        for begin, end in pairwise(cuts):
            self._fail()
            exposure = (light[begin - first :], end - begin, self._charge.size, self._charge, spikes[begin - first :])
            pattern = (self._threads, self._keys, self._gain, self._dark, self._full, self._limit)
            _expose(*exposure, *pattern, self._electrons, self._thermal, self.tick)
            self.tick = end
        return spikes

    def expose_reference(self, intensity: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Do what `expose` does, bit for bit, in readable NumPy."""
        light = self._read(intensity)
        spikes = np.empty(light.shape, dtype=np.uint8)
        for plane, seen in zip(spikes, light, strict=True):
            self._fail()
            with np.errstate(over="ignore"):
                bits = _mix(self._keys + np.uint64(self.tick & (2**64 - 1)) * _TICK_STEP)
            mean = np.clip(seen.astype(np.float64).ravel(), 0, 1e6) * self._gain + self._dark
            noisy = mean + np.sqrt(mean / self._electrons) * _normal(bits)
            charge = self._charge + (np.clip(noisy, 0, 1) * _SPIKE + 0.5).astype(np.uint64)
            fired = charge >= self._limit
            self._charge[:] = np.where(fired, charge - self._limit, charge)
            thermal = self._thermal * _normal(_mix(bits ^ _RESET_SALT))
            renewed = (self._full.astype(np.int64) + np.floor(thermal + 0.5).astype(np.int64)).astype(np.uint64)
            self._limit[:] = np.where(fired, renewed, self._limit)
            plane[:] = fired.reshape(self.shape)
            self.tick += 1
        return spikes

    def _fail(self) -> None:
        """Let the pixels fail whose tick this is."""
        now = self.failures.at(self.tick)
        pixels = self.failures.pixels[now]
        self._gain[pixels], self._dark[pixels] = 0.0, self.failures.dark[now]

    def _read(self, intensity: NDArray[np.float32]) -> NDArray[np.float32]:
        light, traits = self._checked(intensity), self.traits
        if not (traits.row_jitter or traits.blooming):
            return light
        options = (traits.row_jitter, traits.blooming)
        return read_out(light, self._row_keys, self.tick, *options, threads=self._threads)

    def _checked(self, intensity: NDArray[np.float32]) -> NDArray[np.float32]:
        if intensity.ndim != 3 or intensity.shape[1:] != self.shape:
            raise BadRecordingError(f"found light of shape {intensity.shape}", f"(n, {self.shape})")
        light = np.ascontiguousarray(intensity, dtype=np.float32)
        if np.isnan(light.min(initial=0)):
            raise BadRecordingError("found NaN in the light on the sensor", "numbers", "mend the scene")
        return light


def _normal(bits: NDArray[np.uint64]) -> NDArray[np.float64]:
    """Return about normal numbers of mean 0 and variance 1, each the sum of four uniform ones of 16 bits."""
    parts = [(bits >> np.uint64(16 * i)) & np.uint64(65535) for i in range(4)]
    return (np.sum(parts, axis=0).astype(np.float64) - 131070.0) * _NORMAL_SCALE


def _fixed_pattern(
    rng: np.random.Generator, pixels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint64]]:
    """Draw gain, dark current (spikes per tick) and threshold (units of charge) of each pixel.

    Dead pixels neither gain nor leak anything.
    """
    gain = 1 + GAIN_SPREAD * rng.standard_normal(pixels)
    dark = DARK_LEVEL * np.maximum(0, 1 + DARK_SPREAD * rng.standard_normal(pixels))
    chance = rng.random(pixels)
    hot, dead = chance < DEFECT_SHARE, chance > 1 - DEFECT_SHARE
    dark[hot] = rng.uniform(*HOT_LEVELS, pixels)[hot]
    gain[dead], dark[dead] = 0.0, 0.0
    full = np.maximum(0.5, 1 + THRESHOLD_SPREAD * rng.standard_normal(pixels)) * _SPIKE
    return gain, dark, np.round(full).astype(np.uint64)
