"""Notes which blocks of a stream are on the disk, a line a block, so that a crash leaves no doubt about the file.

A line is JSON: `{"block": 3, "planes": 80, "xxh3": "..."}` once all bytes of the block were written,
`{"gap": [first plane, planes, layer]}` before the block in which the gap ends; older ones have `{"skew_s": ...}`.

A recorder that is killed loses no line. When the machine itself goes down, the last second is lost, since files are
flushed once a second (`flusher`). Behind that, lines may be there without their bytes, or bytes without their lines; so
`finalise` reads every block back and compares it with the line's digest. The manifest is flushed when the cameras are
armed and started, and everything once at the end, before the recording takes its name.
"""

import json
import os
from collections import deque
from pathlib import Path
from typing import NamedTuple

from acquisition.errors import BadRecordingError
from acquisition.recording.losses import clip_gaps
from acquisition.recording.manifest import Gap

SUFFIX = ".journal"


class Journal:
    """The lines of a stream; each waits until the file holds what it promises."""

    def __init__(self, path: Path):
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o666)
        self._waiting: deque[tuple[int, str]] = deque()

    def promise(self, end: int, record: dict) -> None:
        """Note that `record` holds when the file's first `end` bytes are written."""
        self._waiting.append((end, json.dumps(record) + "\n"))

    def keep(self, written: int) -> None:
        """Append what holds now that the file's first `written` bytes are on the disk."""
        lines = []
        while self._waiting and self._waiting[0][0] <= written:
            lines.append(self._waiting.popleft()[1])
        if lines:
            os.write(self._handle, "".join(lines).encode())

    def close(self) -> None:
        """Close the file; lines that were not kept are forgotten."""
        handle, self._handle = self._handle, -1
        if handle >= 0:
            os.close(handle)


class Journalled(NamedTuple):
    """The contents that a journal proves: whole blocks from the first on, and the gaps among them."""

    digests: tuple[str, ...]
    planes: int
    gaps: tuple[Gap, ...]
    skew_s: float | None


def read_journal(path: Path, block_planes: int) -> Journalled:
    """Read a journal up to its first line that is torn or makes no sense; a missing one proves nothing."""
    digests: list[str] = []
    gaps: list[Gap] = []
    planes, skew_s = 0, None
    try:
        lines = path.read_bytes().split(b"\n")[:-1]  # behind the last newline lies at most a torn line
    except OSError:
        lines = []
    for line in lines:
        try:
            record = json.loads(line)
            if "gap" in record:
                gaps.append(Gap(*record["gap"]))
            elif "skew_s" in record:
                skew_s = float(record["skew_s"])
            elif record["block"] == len(digests) and planes == len(digests) * block_planes:
                planes += min(max(1, int(record["planes"])), block_planes)
                digests.append(str(record["xxh3"]))
            else:
                break
        except (ValueError, TypeError, KeyError, BadRecordingError, RecursionError):
            break
    return Journalled(tuple(digests), planes, clip_gaps(gaps, planes), skew_s)
