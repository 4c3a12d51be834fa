"""Ranges of bytes (RFC 9110, 14): what a client asks for, and the pieces of a stream that hold it."""

import re
from collections.abc import Iterator

from server.errors import RangeError

_MOST = 100  # ranges of one request
_ONE = re.compile(r"\s*(?:(\d{1,18})-(\d{0,18})|-(\d{1,18}))\s*")


def ranges_of(header: str, size: int) -> list[tuple[int, int]]:
    """Return the ranges, each from its first byte to behind its last, that a Range header asks of `size` bytes.

    Raises RangeError where it makes no sense or names a byte that is not there.
    """
    unit, _, listed = header.partition("=")
    parts = listed.split(",")
    if unit.strip().lower() != "bytes" or len(parts) > _MOST:
        raise RangeError(header, size)
    found = []
    for part in parts:
        match = _ONE.fullmatch(part)
        if match is None:
            raise RangeError(header, size)
        first = int(match[1]) if match[1] else max(0, size - int(match[3]))
        last = min(int(match[2]), size - 1) if match[2] else size - 1
        if first > last:
            raise RangeError(header, size)
        found.append((first, last + 1))
    return found


def cut(pieces: Iterator[bytes], first: int, end: int) -> Iterator[bytes]:
    """Yield the bytes from `first` to before `end` of a stream of pieces."""
    at = 0
    for piece in pieces:
        if at + len(piece) > first:
            yield piece[max(0, first - at) : end - at]
        at += len(piece)
        if at >= end:
            return
