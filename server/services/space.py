"""Promises the room on the disk to uploads and captures, so that what begins fits beside what has begun."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from acquisition.recording.writer import partial_of
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig
from server.errors import NoRoomError
from server.store.store import Store
from server.store.tables import Entry

_SHORTEST_S = 0.1  # room for a recording whose length nobody knows


class Space:
    """The room on the disk of one service, and the rigs whose recordings need it."""

    def __init__(self, store: Store, rigs: dict[str, Rig]) -> None:
        self._store = store
        self.rigs = rigs
        self._one_at_a_time = threading.Lock()

    @contextmanager
    def promised(self, wanted: int) -> Iterator[None]:
        """Begin something of `wanted` bytes in the block, alone; raises NoRoomError where they do not fit."""
        with self._one_at_a_time:
            free = max(0, self._store.disk.free() - self._to_come())
            if wanted > free:
                raise NoRoomError(f"found {free} bytes free", f"the {wanted} that are asked for", "delete something")
            yield

    def recording_bytes(self, rig: str, request: dict) -> int:
        """Return the size that a recording will have or, where only its end decides, at least has."""
        seconds = (request.get("pre_trigger_ms") or 0) / 1e3 + _SHORTEST_S
        described = self.rigs[rig]
        ticks = request["ticks"] or round(seconds * described.tick_rate_hz)
        return ticks * tick_bytes(described)

    def _to_come(self) -> int:
        """Return the bytes that open uploads and captures under way were promised and have not filled yet."""
        received = self._store.folder.received
        uploads = (max(0, upload.bytes - received(upload.id)) for upload in self._store.uploads.open())
        return sum(uploads) + sum(self._unfilled(entry) for entry in self._store.entries.unfinished())

    def _unfilled(self, entry: Entry) -> int:
        if entry.type != "record" or entry.rig not in self.rigs:
            return 0
        filled = sum(file.stat().st_size for file in partial_of(self._store.folder.recording(entry.id)).glob("*.dat"))
        return max(0, self.recording_bytes(entry.rig, entry.request) - filled)


def tick_bytes(rig: Rig) -> int:
    """Return the bytes that all cameras of a rig send in one tick."""
    return sum(PlaneLayout(camera.width, camera.height).plane_bytes for camera in rig.cameras)
