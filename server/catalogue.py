"""The catalogue: a folder for each capture and job beside the recordings and runs they make.

DATA/dbos.sqlite            the job engine's database
DATA/worker.json            the worker's heartbeat
DATA/catalogue/ID/          entry.json (what was asked), progress.json (how far it is), log.txt
DATA/captures/CID/          the recording
DATA/jobs/JID/run/          the run folder
DATA/rigs/RIG/              held by flock while the rig records
"""

from __future__ import annotations

import json
import re
import secrets
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from acquisition.durable import write_json
from server.errors import NotFoundError
from server.schemas import Progress

Kind = Literal["capture", "job"]
_ID = re.compile(r"[cj]\d{8}-\d{6}-[0-9a-f]{4}")


def now() -> datetime:
    """The time in UTC."""
    return datetime.now(UTC)


@dataclass(frozen=True)
class Entry:
    """What was asked for, when; `request` is the request's JSON, for a capture with its `rig`."""

    id: str
    kind: Kind
    created: str
    request: dict[str, Any]


class Catalogue:
    """Captures and jobs under a data folder; the web process adds entries, the worker writes their progress."""

    def __init__(
        self,
        data: Path,
        clock: Callable[[], datetime] = now,
        token: Callable[[], str] = lambda: secrets.token_hex(2),
    ) -> None:
        self.data = data
        self._clock = clock
        self._token = token
        for name in ("catalogue", "captures", "jobs", "rigs"):
            (data / name).mkdir(parents=True, exist_ok=True)

    def add(self, kind: Kind, request: dict[str, Any]) -> Entry:
        """A new entry; ids sort by time."""
        created = self._clock()
        entry = Entry(
            f"{kind[0]}{created:%Y%m%d-%H%M%S}-{self._token()}", kind, created.isoformat("T", "seconds"), request
        )
        self.folder(entry.id).mkdir()
        write_json(self.folder(entry.id) / "entry.json", asdict(entry))
        return entry

    def remove(self, entry_id: str) -> None:
        """Forget an entry that was never queued."""
        (self.folder(entry_id) / "entry.json").unlink()
        self.folder(entry_id).rmdir()

    def entry(self, kind: Kind, entry_id: str) -> Entry:
        """One entry; raises NotFoundError."""
        known = _ID.fullmatch(entry_id) and entry_id[0] == kind[0]
        found = _read_json(self.folder(entry_id) / "entry.json") if known else None
        if found is None:
            raise NotFoundError(f"found no {kind} {entry_id[:60]}, expected one that GET /v1/{kind}s lists")
        return Entry(**found)

    def entries(self, kind: Kind) -> list[Entry]:
        """All entries of a kind, newest first."""
        found = [_read_json(path) for path in (self.data / "catalogue").glob(f"{kind[0]}*/entry.json")]
        return sorted((Entry(**entry) for entry in found if entry), key=lambda entry: entry.id, reverse=True)

    def progress(self, entry_id: str) -> Progress:
        """How far an entry is; nothing before its first stage."""
        return Progress(**(_read_json(self.folder(entry_id) / "progress.json") or {}))

    def write_progress(self, entry_id: str, progress: Progress) -> None:
        """Say how far an entry is."""
        write_json(self.folder(entry_id) / "progress.json", progress.model_dump())

    def folder(self, entry_id: str) -> Path:
        """The entry's own folder; its flock is held while a stage runs."""
        return self.data / "catalogue" / entry_id

    def log(self, entry_id: str) -> Path:
        """What the stages wrote."""
        return self.folder(entry_id) / "log.txt"

    def recording(self, capture_id: str) -> Path:
        """The recording folder of a capture."""
        return self.data / "captures" / capture_id

    def run(self, job_id: str) -> Path:
        """The run folder of a job."""
        return self.data / "jobs" / job_id / "run"

    def rig_lock(self, rig_id: str) -> Path:
        """The folder whose flock is held while a rig records."""
        folder = self.data / "rigs" / rig_id
        folder.mkdir(exist_ok=True)
        return folder


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return None
