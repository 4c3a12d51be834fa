"""Measures how fast one core finds blocks in the bytes of a stream: the parser alone, beside a plain copy."""

import time

import numpy as np

from acquisition.devices.protocol import Block, BlockParser, encode_block
from acquisition.errors import DeviceError
from acquisition.recording.bench import BLOCK_PLANES, LAYOUT

_DISTINCT = 16  # blocks of random planes, sent again and again: 16 MB, more than the caches near a core


def parser_rows(total_bytes: int, memcpy_gb_s: float) -> tuple[list[dict], dict[str, float]]:
    """Return rows and summary of parsing `total_bytes`: blocks fed whole, as most transfers are, and cut in two.

    A row has blocks/s, GB/s and GB/s as a share of `memcpy_gb_s`, by the processor's own clock. Raises DeviceError
    where the parser does not give back every block.
    """
    rng = np.random.default_rng(0)
    blocks = [encode_block(_block(number, rng)) for number in range(_DISTINCT)]
    rounds = max(1, total_bytes // sum(map(len, blocks)))
    cuts = rng.integers(1, len(blocks[0]), _DISTINCT)
    halves = [(data[:at], data[at:]) for data, at in zip(blocks, cuts, strict=True)]
    cases = {"whole": [(data,) for data in blocks], "cut": halves}
    rows, summary = [], {}
    for case, pieces in cases.items():
        seconds = _parse_s(pieces, rounds)
        gb_s = rounds * sum(map(len, blocks)) / seconds / 1e9
        rate = rounds * _DISTINCT / seconds
        measured = {"blocks_per_s": rate, "gb_s": gb_s, "share_of_memcpy": gb_s / memcpy_gb_s}
        rows.append({"case": f"parser, {case} blocks", **measured, "seconds": seconds})
        summary |= {f"parser_{case}_blocks_per_s": rate, f"parser_{case}_gb_s": gb_s}
    return rows, summary


def _block(number: int, rng: np.random.Generator) -> Block:
    packed = rng.integers(0, 256, (BLOCK_PLANES, LAYOUT.plane_bytes), np.uint8)
    return Block(number, number * BLOCK_PLANES, number * 4_000_000, LAYOUT, packed, 1, 0, 0, 0)


def _parse_s(pieces: list[tuple[bytes, ...]], rounds: int) -> float:
    """Return the processor seconds of this thread for all pieces, `rounds` times."""
    parser, found = BlockParser(), 0
    begin_s = time.thread_time()
    for _ in range(rounds):
        for parts in pieces:
            for part in parts:
                parser.feed(part)
            while parser.next():
                found += 1
    seconds = time.thread_time() - begin_s
    if found != rounds * len(pieces) or parser.damages:
        wrong = f"found {found} blocks and {parser.damages} damages in a sound stream"
        raise DeviceError(wrong, f"{rounds * len(pieces)} and none")
    return seconds
