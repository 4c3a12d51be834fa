"""The spans that a long recording is cut into."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from itertools import pairwise

PLANES = 400  # most planes of a span: bodies are followed between eight instants of it
LEAST = 64  # planes of the shortest span that may be asked for
LONG = 1.5  # spans from which a recording is cut
STILL_SHARE = 5e-4  # share of moving pixels below which nothing moves
OVERLAP = 24  # planes beyond either end that a span's movers are learnt from, so that neighbours agree at the seam


@dataclass(frozen=True)
class Span:
    """The planes [first, last) of a recording."""

    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first

    def grown(self, by: int, planes: int) -> "Span":
        """Return the span with as many planes more at either end, within a recording of so many."""
        return Span(max(0, self.first - by), min(planes, self.last + by))


def cut(planes: int, most: int = PLANES) -> tuple[Span, ...]:
    """Return even spans of at most `most` planes; a recording little longer than one span is one."""
    count = 1 if planes < LONG * most else -(-planes // most)
    ends = [planes * i // count for i in range(count + 1)]
    return tuple(Span(first, last) for first, last in pairwise(ends))


def carried_from(moving: Sequence[int]) -> dict[int, int | None]:
    """Return the span that each of the `moving` ones is carried over from; None for one that begins by itself."""
    return dict.fromkeys(moving)


def learning_order(carried: Mapping[int, int | None]) -> list[int]:
    """Return the spans in an order in which each comes after the one that it is carried over from."""
    before = {number: () if source is None else (source,) for number, source in carried.items()}
    return list(TopologicalSorter(before).static_order())
