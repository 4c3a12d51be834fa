"""Promises the room on the disk to uploads, captures and imports: what begins fits beside what has begun."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from acquisition.recording.writer import partial_of
from acquisition.spikes.layout import PlaneLayout
from rigs.rig import Rig
from server.errors import NoRoomError
from server.store.store import Store
from server.store.tables import Entry

_SHORTEST_S = 0.1  # room for a recording whose length nobody knows
_BLOCK = 512  # bytes that `stat` counts as one


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
        """Return the bytes that uploads, captures and imports under way were promised and have not taken yet."""
        received = self._store.folder.received
        uploads = (max(0, upload.bytes - received(upload.id)) for upload in self._store.uploads.open())
        return sum(uploads) + sum(self._unfilled(entry) for entry in self._store.entries.unfinished())

    def _unfilled(self, entry: Entry) -> int:
        recording = self._store.folder.recording(entry.id)
        if recording.exists():  # its end is not announced yet
            return 0
        if entry.type == "import":
            promised = sum(map(self._store.folder.received, entry.request.get("dats", ())))
        elif entry.type == "record" and entry.rig in self.rigs:
            promised = self.recording_bytes(entry.rig, entry.request)
        else:
            return 0
        return max(0, promised - sum(map(_taken, partial_of(recording).glob("*.dat"))))


def tick_bytes(rig: Rig) -> int:
    """Return the bytes that all cameras of a rig send in one tick."""
    return sum(PlaneLayout(camera.width, camera.height).plane_bytes for camera in rig.cameras)


def _taken(file: Path) -> int:
    """Return the bytes of the disk that a file has, those among them that a recorder has reserved and not filled."""
    try:
        stat = file.stat()
    except FileNotFoundError:  # it has just got its name, or is being deleted
        return 0
    return max(stat.st_size, _BLOCK * stat.st_blocks)
