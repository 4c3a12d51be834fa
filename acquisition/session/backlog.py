"""Planes on their way from a camera to its file: held before the recording begins, then written or counted as lost."""

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import DiskError
from acquisition.recording.manifest import Gap, Layer
from acquisition.recording.stream_writer import StreamWriter


@dataclass(frozen=True, eq=False)
class Held:
    """Planes [n, B] not yet given to the ring, or only their number and the `layer` that lost them.

    `lost` planes were missing before them, of which the device says it dropped `dropped`.
    """

    first_plane: int
    planes: int
    packed: NDArray[np.uint8]
    lost: int
    dropped: int
    layer: Layer | None = None


class Backlog:
    """Gives planes to the ring of `writer`, and holds up to `may_hold` that it has not taken.

    Planes [first, end) are recorded, counted as the camera counts them; until `first` is set, the newest planes are
    held. With `waits`, a full ring holds the camera up instead of losing planes.
    """

    def __init__(self, writer: StreamWriter, may_hold: int, *, waits: bool):
        self.first: int | None = None
        self.end: float = math.inf
        self._writer, self._may_hold, self._waits = writer, may_hold, waits
        self._held: deque[Held] = deque()
        self._held_planes = 0

    def add(self, held: Held) -> None:
        """Take planes and give the ring what it takes; the rest is held as far as `may_hold` allows, or lost."""
        self._held.append(held)
        self._held_planes += held.planes
        if self.first is None:
            while self._held and self._held_planes - self._held[0].planes > self._may_hold:
                self._let_go(self._held.popleft())
            return
        while self._held and self._give(self._held[0], wait=self._waits):
            self._let_go(self._held.popleft())
        if self._held_planes > self._may_hold:
            newest = self._held.pop()
            self._let_go(newest)
            self._held.append(replace(newest, packed=newest.packed[:0], layer=self._writer.refusing))
            if len(self._held) == 1:
                self._give(self._held.popleft(), wait=False)

    def finish(self) -> None:
        """Give the ring all that is held, waiting for it."""
        while self.first is not None and self._held:
            self._give(self._held[0], wait=True)
            self._let_go(self._held.popleft())

    def _let_go(self, held: Held) -> None:
        self._held_planes -= 0 if held.layer else held.planes

    def _give(self, held: Held, *, wait: bool) -> bool:
        """Write the planes within [first, end), gaps before them included; False where the ring has no room."""
        first, writer = self.first or 0, self._writer
        begin, end = first + writer.planes, min(self.end, held.first_plane + held.planes)
        missing = int(min(held.first_plane, end)) - begin
        if missing > 0:
            on_the_way = min(missing, held.lost)
            at = writer.planes
            forgotten = [Gap(at, missing - on_the_way, "ring")] if missing > on_the_way else []
            writer.append_lost(forgotten + gaps_of(at + missing - on_the_way, on_the_way, held.dropped))
            begin += missing
        count = int(end) - begin
        if count <= 0:
            return True
        if held.layer:
            writer.append_lost([Gap(begin - first, count, held.layer)])
            return True
        skipped = begin - held.first_plane
        packed = held.packed[skipped : skipped + count]
        if not wait:
            return writer.offer(packed)
        try:
            writer.append(packed)
        except DiskError:
            writer.append_lost([Gap(begin - first, count, "disk")])
        return True


def gaps_of(first: int, lost: int, dropped_by_device: int) -> list[Gap]:
    """Return the gaps of `lost` planes from `first` on: those the device says it dropped, then those the link lost."""
    device = min(lost, max(0, dropped_by_device))
    layers: list[tuple[int, int, Layer]] = [(first, device, "device"), (first + device, lost - device, "link")]
    return [Gap(at, planes, layer) for at, planes, layer in layers if planes]
