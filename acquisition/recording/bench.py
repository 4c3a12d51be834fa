"""Measures the recorder on a disk: its rings and writers are fed by blocks that cost nothing to make.

Nine streams of 400x250 planes come in blocks of a megabyte, as nine cameras send them. Long runs go round a bounded set
of files. Rates are in MB/s (10^6 bytes). They are compared with the disk's own rate, the lower of one measured before
and one measured after.
"""

import contextlib
import mmap
import shutil
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument, fastest_s
from acquisition.errors import DiskError
from acquisition.progress import Progress, silent
from acquisition.recording.chunk_writer import StreamSpace
from acquisition.recording.direct import DirectFile
from acquisition.recording.flusher import EVERY_S, Flusher
from acquisition.recording.manifest import Gap
from acquisition.recording.stream_writer import StreamWriter
from acquisition.spikes.layout import PlaneLayout

STREAMS = 9
LAYOUT = PlaneLayout(400, 250)
BLOCK_PLANES = 80
BLOCK_BYTES = BLOCK_PLANES * LAYOUT.plane_bytes
LAP_BYTES = 800 << 20  # size of each file: 7.5 GB in all
RING_BYTES = 64 << 20
FRACTIONS = (0.98, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7)
RAM_FOLDER = Path("/dev/shm")
_WRITE_BYTES = 1 << 20
_NEVER_S = 1e6


@dataclass(frozen=True)
class Schedule:
    """The duration of each part, or the bytes that it writes."""

    disk_s: float = 8.0
    steady_s: float = 60.0
    search_s: float = 10.0
    overload_bytes: int = STREAMS * LAP_BYTES
    ram_bytes: int = 2_000_000_000


QUICK = Schedule(1.0, 3.0, 1.0, 900_000_000, 450_000_000)


class LapFile(DirectFile):
    """A file that is written round and round inside LAP_BYTES, and removed at the end."""

    def __init__(self, path: Path):
        super().__init__(path)
        self.reserve(LAP_BYTES)

    def write(self, data: memoryview, offset: int) -> None:
        """Put `data` where the lap stands."""
        super().write(data, offset % LAP_BYTES)

    def finish(self, size: int) -> None:
        """Close and remove."""
        self.abandon()
        self.path.unlink()


def bench_recorder(folder: Path, schedule: Schedule, progress: Progress = silent) -> BenchDocument:
    """Measure the recorder on the disk of the new `folder`, which is removed afterwards.

    Raises DiskError where 9 GB are not free.
    """
    folder.mkdir(parents=True)
    try:
        free = shutil.disk_usage(folder).free
        if free < 9_000_000_000:
            raise DiskError(f"found {free} bytes free", "9000000000", "give --out on another disk", where=folder)
        rows, summary = _measure(folder, schedule, progress)
        return BenchDocument("recorder", rows, [], summary)
    finally:
        shutil.rmtree(folder)


def _measure(folder: Path, schedule: Schedule, progress: Progress) -> tuple[list[dict], dict[str, float]]:
    progress(0.0, "the disk")
    before = disk_mb_s(folder, schedule.disk_s)
    progress(0.1, "60% of it")
    steady = paced_row(folder, "60 %", 0.6 * before, schedule.steady_s)
    progress(0.4, "60% of it, never flushed")
    unflushed = paced_row(folder, "60 %, never flushed", 0.6 * before, schedule.steady_s / 2, every_s=_NEVER_S)
    progress(0.5, "the highest rate without a loss")
    search = []
    for fraction in FRACTIONS:
        search.append(paced_row(folder, f"{fraction:.0%}", fraction * before, schedule.search_s))
        if not search[-1]["dropped_blocks"]:
            break
    progress(0.8, "120% of it")
    overload = overload_row(folder, 1.2 * before, schedule.overload_bytes)
    progress(0.9, "the disk again")
    after = disk_mb_s(folder, schedule.disk_s)
    ram = max((ram_row(schedule.ram_bytes) for _ in range(3)), key=lambda row: row["mb_s"])
    copy = memcpy_gb_s()
    disk = min(before, after)
    disk_rows = [
        {"case": "disk before", "mb_s": before, "seconds": schedule.disk_s},
        {"case": "disk after", "mb_s": after, "seconds": schedule.disk_s},
    ]
    lossfree = search[-1]["mb_s"] if not search[-1]["dropped_blocks"] else 0.0
    progress(1.0, f"{disk:.0f} MB/s")
    return [*disk_rows, steady, unflushed, *search, overload, ram], {
        "disk_mb_s": disk,
        "lossfree_fraction_of_disk": lossfree / disk,
        "drops_at_60_percent": steady["dropped_blocks"],
        "cores_at_60_percent": steady["cores"],
        "flush_s_at_60_percent": steady["flush_s"],
        "cores_for_flushing": steady["cores"] - unflushed["cores"],
        "drops_at_120_percent": overload["dropped_blocks"],
        "unreported_drops_at_120_percent": overload["unreported_blocks"],
        "ram_gb_s": ram["mb_s"] / 1e3,
        "memcpy_gb_s": copy,
    }


def disk_mb_s(folder: Path, seconds: float) -> float:
    """Return the MB/s of plain direct writes of a mebibyte, a thread a file, with nothing else done."""
    data = memoryview(mmap.mmap(-1, _WRITE_BYTES))
    start_s = time.perf_counter()

    def write(number: int) -> int:
        file = LapFile(folder / f"disk{number}")
        offset = 0
        while time.perf_counter() - start_s < seconds:
            file.write(data, offset)
            offset += len(data)
        file.finish(offset)
        return offset

    with ThreadPoolExecutor(STREAMS) as pool:
        written = sum(pool.map(write, range(STREAMS)))
    return written / (time.perf_counter() - start_s) / 1e6


def paced_row(folder: Path, case: str, mb_s: float, seconds: float, every_s: float = EVERY_S) -> dict:
    """Run all streams at `mb_s` together, round the bounded files, hashed, journalled, flushed every `every_s`."""
    space = StreamSpace(RING_BYTES, allows=lambda size: False, open_file=LapFile)
    blocks = max(1, round(mb_s * 1e6 * seconds / BLOCK_BYTES / STREAMS))
    with _fed(folder / "paced", space, blocks, seconds / blocks, every_s) as (writers, spent, _):
        lost = sum(gap.planes for writer in writers for gap in writer.gaps)
    found = {"offered_blocks": blocks * STREAMS, "dropped_blocks": lost // BLOCK_PLANES}
    return {"case": case, "mb_s": mb_s, **found, **spent}


def overload_row(folder: Path, mb_s: float, total_bytes: int) -> dict:
    """Write more than the disk takes into whole files, then look up every block: there, or zeros and listed."""
    blocks = total_bytes // BLOCK_BYTES // STREAMS
    period_s = BLOCK_BYTES * STREAMS / (mb_s * 1e6)
    dropped = unreported = 0
    with _fed(folder / "over", StreamSpace(4 << 20, blocks * BLOCK_PLANES), blocks, period_s) as (writers, spent, _):
        for writer in writers:
            lost = np.zeros(blocks, dtype=bool)
            for gap in writer.gaps:
                lost[gap.first_plane // BLOCK_PLANES : (gap.first_plane + gap.planes) // BLOCK_PLANES] = True
            stamps = np.memmap(writer.path, dtype=np.uint8, mode="r", shape=(blocks, BLOCK_BYTES))[:, :8]
            expected = np.where(lost, 0, np.arange(1, blocks + 1)).astype("<u8")
            unreported += int((np.ascontiguousarray(stamps).view("<u8")[:, 0] != expected).sum())
            unreported += abs(writer.planes - blocks * BLOCK_PLANES)
            dropped += int(lost.sum())
    found = {"offered_blocks": blocks * STREAMS, "dropped_blocks": dropped, "unreported_blocks": unreported}
    return {"case": "120 %", "mb_s": mb_s, **found, **spent}


def ram_row(total_bytes: int) -> dict:
    """Write into files in memory as fast as it goes, all streams waiting for room: the limit of the recorder itself."""
    folder = RAM_FOLDER / f"spike4dgs-bench-{time.monotonic_ns()}"
    blocks = total_bytes // BLOCK_BYTES // STREAMS
    with _fed(folder, StreamSpace(4 << 20, allows=lambda size: False), blocks, 0.0) as (_, spent, written_s):
        mb_s = blocks * BLOCK_BYTES * STREAMS / written_s / 1e6
    cores = spent["cores"] * spent["seconds"] / written_s
    return {"case": "memory", "mb_s": mb_s, "cores": cores, "seconds": written_s}


def memcpy_gb_s() -> float:
    """Return the GB/s at which one thread copies 256 MB, the best of five."""
    source, target = np.ones(256_000_000, np.uint8), np.zeros(256_000_000, np.uint8)
    return source.nbytes / fastest_s(lambda: np.copyto(target, source), 5) / 1e9


@contextlib.contextmanager
def _fed(
    folder: Path, space: StreamSpace, blocks: int, period_s: float, every_s: float = EVERY_S
) -> Iterator[tuple[list[StreamWriter], dict[str, float], float]]:
    """Feed all streams, which begin one after another, in the new `folder`, which is removed at the end.

    Yields the closed writers, the cores and seconds until all was offered, and the seconds until all was written.
    """
    folder.mkdir()
    try:
        writers = [StreamWriter(folder, f"cam{n}", LAYOUT, space) for n in range(STREAMS)]
        pools = np.random.default_rng(blocks).integers(0, 256, (STREAMS, 4, BLOCK_PLANES, LAYOUT.plane_bytes), np.uint8)
        start_s, cpu_s = time.perf_counter(), time.process_time()
        starts_s = [start_s + n * period_s / STREAMS for n in range(STREAMS)]
        with Flusher(folder, "*", every_s=every_s) as flusher, ThreadPoolExecutor(STREAMS) as threads:
            list(threads.map(_feed, writers, pools, starts_s, repeat(blocks), repeat(period_s)))
        cpu_s, offered_s = time.process_time() - cpu_s, time.perf_counter() - start_s
        for writer in writers:
            writer.close()
        flush_s = flusher.spent_s / max(1, flusher.rounds)
        spent = {"cores": cpu_s / offered_s, "seconds": offered_s, "flush_s": flush_s}
        yield writers, spent, time.perf_counter() - start_s
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _feed(writer: StreamWriter, pool: NDArray[np.uint8], start_s: float, blocks: int, period_s: float) -> None:
    """Feed a stream blocks at a steady pace, each stamped with its number; what the ring does not take is lost.

    Without a period it waits for room instead.
    """
    for number in range(blocks):
        pause_s = start_s + number * period_s - time.perf_counter()
        if pause_s > 0:
            time.sleep(pause_s)
        block = pool[number % len(pool)]
        block[0, :8] = np.array([number + 1], dtype="<u8").view(np.uint8)
        if not period_s:
            writer.append(block)
        elif not writer.offer(block):
            writer.append_lost([Gap(number * BLOCK_PLANES, BLOCK_PLANES, writer.refusing)])
