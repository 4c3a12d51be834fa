"""Measures compact recordings: how small they become, and how fast they are written and read.

Every camera of a recording is compressed in memory, block by block, on one thread. Seconds are of the processor, the
least of several repeats; rates are MB (10^6 bytes) of planes a second. What was not chosen is measured on the first
block of the middle camera: planes as they are, planes after the exclusive-or with the plane before, and the trains of
pixels, under several coders.
"""

import bz2
import lzma
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import zstandard

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress, silent
from acquisition.spikes.compact import LEVEL, block_planes_of, decode, encode
from acquisition.spikes.stream import SpikeStream
from acquisition.spikes.transposed import Bytes, planes_of, trains_of

REPEATS = 3
CHOSEN = f"trains, zstd {LEVEL}"
_LZMA = ({"id": lzma.FILTER_LZMA2, "preset": 1, "lc": 4, "lp": 0, "pb": 0},)  # a literal's context: half a byte before
_Made = TypeVar("_Made")


class Coder(NamedTuple):
    """A way to compress bytes, and the way back."""

    write: Callable[[bytes], bytes]
    read: Callable[[bytes], bytes]


def _zstd(level: int) -> Coder:
    return Coder(zstandard.ZstdCompressor(level=level).compress, zstandard.ZstdDecompressor().decompress)


CODERS: Mapping[str, Coder] = {
    **{f"zstd {level}": _zstd(level) for level in (1, 3, 7, 12)},
    "zlib 6": Coder(lambda data: zlib.compress(data, 6), zlib.decompress),
    "bz2 9": Coder(bz2.compress, bz2.decompress),
    "lzma 1": Coder(
        lambda data: lzma.compress(data, lzma.FORMAT_RAW, filters=_LZMA),
        lambda data: lzma.decompress(data, lzma.FORMAT_RAW, filters=_LZMA),
    ),
}


def bench_compact(recordings: Mapping[str, Sequence[SpikeStream]], progress: Progress = silent) -> BenchDocument:
    """Measure recordings by name, each the streams of its cameras."""
    document = BenchDocument("compact")
    for number, (name, streams) in enumerate(recordings.items()):
        progress(number / len(recordings), name)
        row = {"recording": name, "method": CHOSEN, "cameras": len(streams)} | _chosen(streams)
        document.rows.append(row)
        scores = ("ratio", "write_mb_s", "read_mb_s", "plane_ms")
        document.summary |= {f"{name}.{score}": row[score] for score in scores}
        document.rows += [{"recording": name, **other} for other in _others(streams[len(streams) // 2])]
    for method in dict.fromkeys(row["method"] for row in document.rows):
        own = [row for row in document.rows if row["method"] == method]
        for score in ("ratio", "write_mb_s", "read_mb_s"):  # of rates and ratios: the harmonic mean
            document.summary[f"{method}.{score}"] = len(own) / sum(1 / row[score] for row in own)
    progress(1.0, f"{len(recordings)} recordings")
    return document


def _chosen(streams: Sequence[SpikeStream]) -> dict[str, float]:
    """Return the scores of the format that is written, over all cameras and blocks of a recording."""
    planes = packed = most = 0
    write_s = read_s = 0.0
    for stream in streams:
        step = block_planes_of(stream.layout.plane_bytes)
        for first in range(0, len(stream), step):
            part = np.ascontiguousarray(stream.packed[first : first + step])
            block, took_s = _fastest(lambda part=part: encode(part))
            shape = part.shape
            found, back_s = _fastest(lambda block=block, shape=shape: decode(block, *shape))
            _require_same(found, part)
            planes, packed, most = planes + part.nbytes, packed + len(block), max(most, part.nbytes)
            write_s, read_s = write_s + took_s, read_s + back_s
    a_block_s = read_s * most / planes  # also what a single plane costs
    return _scores(planes, packed, write_s, read_s) | {"plane_ms": 1e3 * a_block_s}


def _others(stream: SpikeStream) -> list[dict]:
    """Return a row for each way that was not chosen, of the first block of a stream."""
    part = np.ascontiguousarray(stream.packed[: block_planes_of(stream.layout.plane_bytes)])
    rows = []
    for form, (there, back) in _FORMS.items():
        for name, coder in CODERS.items():
            if f"{form}, {name}" == CHOSEN or (form != "trains" and name not in ("zstd 3", "zstd 7")):
                continue
            packed, write_s = _fastest(lambda there=there, coder=coder: coder.write(there(part).tobytes()))
            found, read_s = _fastest(lambda back=back, coder=coder, packed=packed: back(coder.read(packed), part.shape))
            _require_same(found, part)
            rows.append({"method": f"{form}, {name}"} | _scores(part.nbytes, len(packed), write_s, read_s))
    return rows


def _scores(planes: int, packed: int, write_s: float, read_s: float) -> dict[str, float]:
    rates = {"write_mb_s": planes / write_s / 1e6, "read_mb_s": planes / read_s / 1e6}
    return {"bytes": planes, "ratio": planes / packed, **rates, "seconds": write_s + read_s}


def _fastest(work: Callable[[], _Made]) -> tuple[_Made, float]:
    """Return what `work` makes in a call that warms up, and the least of the processor's seconds of those after it."""
    made, least_s = work(), float("inf")
    for _ in range(REPEATS):
        start_s = time.process_time()
        work()
        least_s = min(least_s, time.process_time() - start_s)
    return made, max(least_s, 1e-9)


def _require_same(found: Bytes, expected: Bytes) -> None:
    assert np.array_equal(found, expected)


def _of_bytes(data: bytes, shape: tuple[int, int]) -> Bytes:
    return np.frombuffer(data, dtype=np.uint8).reshape(shape)


def _differences(planes: Bytes) -> Bytes:
    """Return the exclusive-or of each plane with the one before."""
    return np.concatenate([planes[:1], planes[1:] ^ planes[:-1]])


def _of_trains(data: bytes, shape: tuple[int, int]) -> Bytes:
    return planes_of(np.frombuffer(data, dtype=np.uint8).reshape(8 * shape[1], -1), shape[0])


_FORMS: Mapping[str, tuple[Callable[[Bytes], Bytes], Callable[[bytes, tuple[int, int]], Bytes]]] = {
    "planes": (lambda planes: planes, _of_bytes),
    "differences": (_differences, lambda data, shape: np.bitwise_xor.accumulate(_of_bytes(data, shape))),
    "trains": (trains_of, _of_trains),
}
