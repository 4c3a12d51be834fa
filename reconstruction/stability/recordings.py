"""Defines cases 26, 27 and 29: long recordings, files of any length, views of no use."""

import math
import tempfile
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition.native import code_path, code_paths
from acquisition.recording.manifest import CameraFile, Manifest
from acquisition.recording.reader import Recording
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack, window_means
from acquisition.spikes.stream import SpikeStream
from reconstruction.calibration.verdict import refuse_blind
from reconstruction.images.catalogue import methods
from reconstruction.images.methods.tfi import tfi
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.plan import make_plan
from reconstruction.scene_model import TimeSpan, gain_at
from reconstruction.stability.case import Case, Observation, refusal
from reconstruction.stability.images import ORDERS, SIZE, method_names
from reconstruction.stability.models import cloud_of
from rigs.clock import RigClock
from rigs.rig import Rig
from rigs.toml import catalog_rig

PLANES = 10_000_000
ROW = PlaneLayout(8, 1)  # makes a byte a plane
PERIODS = np.array([1, 2, 3, 4, 5, 7, 9, 11])  # ticks to a spike, by column; together they repeat after 13,860
RATES_HZ = (20000.0, 40000.0, 1e6 / 3, 19999.7)


def _fired(first: int, last: int) -> list[int]:
    """Return the number of spikes of each column in planes [first, last), computed in whole numbers."""
    return [-(-last // int(p)) + (-first // int(p)) for p in PERIODS]


def _long(folder: str) -> SpikeStream:
    """Write a recording of ten megabytes and map it."""
    ticks = np.arange(int(np.lcm.reduce(PERIODS)))[:, None]
    packed = pack((ticks % PERIODS == 0)[:, None], ROW)
    path = Path(folder) / "long.dat"
    path.write_bytes(np.resize(packed, (PLANES, 1)).tobytes())
    return SpikeStream.open(path, ROW, 20000.0)


def _long_counts(_: str) -> Observation:
    """Check counts and means over the whole and over its end, and TFI there, by every code path."""
    error, spans = 0.0, ((0, PLANES), (PLANES - 12345, PLANES), (PLANES - 1, PLANES), (9_999_000, 9_999_033))
    with tempfile.TemporaryDirectory() as folder:
        stream = _long(folder)
        for path in code_paths():
            with code_path(path):
                for first, last in spans:
                    counts = np.array(_fired(first, last))
                    error = max(error, float(np.abs(stream.counts(first, last)[0] - counts).max()))
                    mean = window_means(stream.packed, ROW, np.array([(first, last)]))[0, 0]
                    error = max(error, float(np.abs(mean - (counts / (last - first)).astype(np.float32)).max()))
                for plane in (PLANES - 20, PLANES - 5_000_001, 2**23 + 1):
                    image = tfi(stream, plane)
                    error = max(error, float(np.abs(image.intensity[0] - (1 / PERIODS).astype(np.float32)).max()))
                    error = error if image.valid.all() else math.inf
        del stream
    return Observation(f"{PLANES:,} planes: counts, means and intervals {error:.0e} off", error)


def _long_images(name: str) -> Observation:
    """Compare images late in a long clip with those of the same planes in a clip of their own."""
    differing = 0
    with tempfile.TemporaryDirectory() as folder:
        stream = _long(folder)
        for plane in (PLANES - 1, PLANES - 700, 2**23 + 3):
            window = np.array(stream.window(plane - 700, min(PLANES, plane + 700)))
            short = SpikeStream(window, ROW, 20000.0)
            long, own = methods()[name](stream, plane), methods()[name](short, 700)
            differing += int((long.intensity != own.intensity).sum() + (long.valid != own.valid).sum())
        del stream
    return Observation(f"{differing} pixels differ from those of a short clip", float(differing))


def ticks_off(clock: RigClock, plane: int) -> float:
    """Return the error of a plane's instant in ticks, by rational numbers."""
    return abs(float(Fraction(clock.instant_s(plane)) * Fraction(clock.tick_rate_hz) - Fraction(2 * plane + 1, 2)))


def _long_clock(_: str) -> Observation:
    """Compare ticks to seconds and back with rational numbers, up to 10^9 planes."""
    error, wrong = 0.0, 0
    for rate_hz in RATES_HZ:
        clock = RigClock(rate_hz)
        for last in (1000, 2**24 + 500, PLANES, 10**9):
            for plane in range(last - 1000, last):
                error = max(error, ticks_off(clock, plane))
                wrong += (clock.plane(clock.instant_s(plane)) != plane) + (clock.plane(plane / rate_hz) != plane)
    said = f"{wrong} of 32,000 instants in another plane, {error:.0e} ticks off"
    return Observation(said, error if not wrong else math.inf)


def _long_light(_: str) -> Observation:
    """Give every plane a gain, and check that each instant finds its own."""
    cloud = cloud_of("linear", count=1)
    gains = np.resize(np.arange(1009, dtype=np.int16), PLANES)
    cloud.light, cloud.clip = torch.from_numpy(gains), TimeSpan(0.0, PLANES / 20000.0)
    clock, wrong = RigClock(20000.0), 0
    for plane in (*range(1000), *range(2**23, 2**23 + 1000), *range(PLANES - 1000, PLANES)):
        wrong += gain_at(cloud.light, cloud.clip.fraction(clock.instant_s(plane))) != plane % 1009
    return Observation(f"{wrong} of 3,000 planes take another's gain", float(wrong))


def _refused(work: Callable[[], object], *names: str) -> bool:
    """Return whether `work` is refused by an error whose `where` or `found` names all of `names`."""
    error = refusal(work)
    return error is not None and all(name in error.where or name in error.found for name in names)


def _lengths(_: str) -> Observation:
    """Read files of whole planes back, and check that cut, empty and missing ones are refused by name."""
    spikes = (np.random.default_rng(7).random((301, *SIZE)) < 0.3).astype(np.uint8)
    wrong, refused = 0, 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cut.dat"
        for order in ORDERS:
            layout = PlaneLayout(SIZE[1], SIZE[0], *order)
            data = pack(spikes, layout).tobytes()
            for lost in (0, 1, 25, 26, len(data) - 1, len(data)):
                path.write_bytes(data[: len(data) - lost])
                planes, partial = divmod(len(data) - lost, layout.plane_bytes)
                if partial or not planes:
                    wrong += not _refused(lambda: SpikeStream.open(path, layout, 20000.0), "cut.dat")  # noqa: B023
                    refused += 1
                if planes:
                    stream = SpikeStream.open(path, layout, 20000.0, allow_partial=True)
                    wrong += int((stream.planes(0, planes) != spikes[:planes]).sum())
                    wrong += int((stream.counts(0, planes) != spikes[:planes].sum(axis=0)).sum())
                    wrong += stream.partial_bytes != partial
        path.unlink()
        wrong += not _refused(lambda: SpikeStream.open(path, PlaneLayout(8, 1), 20000.0), "cut.dat")
    return Observation(f"{refused + 1} files refused, {wrong} bits or refusals wrong", float(wrong))


def _rig(views: int) -> Rig:
    rig = catalog_rig("ci3x3").scaled(40, 26)
    return rig.only(rig.ids[:views])


def _streams(rig: Rig, dark: str | None = None, twin: str | None = None) -> dict[str, SpikeStream]:
    """Return even light with phases of each camera's own; `dark` sees nothing, `twin` has the first one's spikes."""
    layout, ticks, found = PlaneLayout(40, 26), np.arange(160)[:, None, None], {}
    for i, camera in enumerate(rig.ids):
        phases = np.random.default_rng(0 if camera == twin else i).integers(0, 3, (26, 40))
        spikes: NDArray[np.bool_] = ((ticks + phases) % 3 == 0) & (camera != dark)
        found[camera] = SpikeStream(pack(spikes, layout), layout, 20000.0)
    return found


def _useless_views(_: str) -> Observation:
    """Check that a dark view is left out, a dropped or doubled one refused, and one view alone too, each by name."""
    four, three, wrong = _rig(4), _rig(3), []
    plan = make_plan(ReconstructionConfig(), four, _streams(four, dark="cam02"))[0]
    skipped = [d.choice for d in plan.decisions if d.about == "views"]
    if plan.views != ("cam00", "cam01", "cam10") or skipped != ["cam02 skipped"]:
        wrong.append("dark")
    if make_plan(ReconstructionConfig(), three, _streams(three))[0].views != three.ids:
        wrong.append("three")
    files = (CameraFile(c, f"{c}.dat", PlaneLayout(40, 26), 0, 0, 1, (), None) for c in ("cam00", "cam02"))
    dropped = Manifest(20000.0, "software", "test", "", tuple(files))
    light = {c: np.full((26, 40), 0.0 if c == "cam01" else 0.3, np.float32) for c in three.ids}
    one = ReconstructionConfig(views=("cam00",))
    refusals = {
        "doubled": (lambda: make_plan(ReconstructionConfig(), three, _streams(three, twin="cam02")), "cam00", "cam02"),
        "dropped": (lambda: Recording(Path("rec"), three, dropped), "cam01"),
        "unknown": (lambda: make_plan(ReconstructionConfig(views=("cam99",)), three, _streams(three)), "cam99"),
        "one": (lambda: make_plan(one, three, _streams(three)), "1 training view"),
        "dark to calibrate": (lambda: refuse_blind(light), "cam01"),
        "two to calibrate": (lambda: refuse_blind(dict(list(light.items())[:2])), "2 views"),
    }
    wrong += [what for what, (work, *names) in refusals.items() if not _refused(work, *names)]
    return Observation(f"{len(refusals) + 2} kinds, wrong: {', '.join(wrong) or 'none'}", float(len(wrong)))


CASES = (
    Case(26, "10^7 planes, counted", "as in whole numbers", 1e-7, _long_counts),
    Case(26, "10^7 planes, as images", "as in a short clip, to the bit", 0.0, _long_images, method_names),
    Case(26, "10^9 planes on the clock", "as in rational numbers", 1e-6, _long_clock),
    Case(26, "10^7 gains of the light", "each plane its own", 0.0, _long_light),
    Case(27, "files of any length", "exact, or refused by name", 0.0, _lengths),
    Case(29, "views of no use", "left out or refused by name", 0.0, _useless_views),
)
