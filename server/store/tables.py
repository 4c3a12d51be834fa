"""The service's own tables, beside those of the job engine: a class describes the rows of each, field by column."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass, field
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from sqlalchemy import JSON, BigInteger, Column, Float, Index, Integer, MetaData, String, Table, Text, UniqueConstraint

Kind = Literal["capture", "job"]
EventKind = Literal["status", "progress"]
Source = Literal["nominal", "natural", "board", "pixels", "uploaded"]
Role = Literal["viewer", "operator"]
Id = Annotated[str, String(32)]
Word = Annotated[str, String(12)]
Name = Annotated[str, String(80)]
Moment = Annotated[str, String(40)]  # ISO 8601, in UTC
RigId = Annotated[str, String(64)]
Sha256 = Annotated[str, String(64)]  # hexadecimal
Bytes = Annotated[int, BigInteger()]
Long = Annotated[str, Text()]
_TYPES = {int: Integer(), float: Float(), dict: JSON(), list: JSON()}

metadata = MetaData()


def _table(name: str, row: type, *more: Index | UniqueConstraint, key: tuple[str, ...] = ("id",), **how: Any) -> Table:
    """Return the table whose columns are the fields of `row`: NULL is allowed where a field may be None."""
    columns = []
    for column, hint in get_type_hints(row, include_extras=True).items():
        optional = NoneType in get_args(hint)
        kind = get_args(hint)[0] if optional else hint
        sql = kind.__metadata__[0] if get_origin(kind) is Annotated else _TYPES[get_origin(kind) or kind]
        columns.append(Column(column, sql, primary_key=column in key, nullable=optional))
    return Table(name, metadata, *columns, *more, **how)


@dataclass(frozen=True)
class Entry:
    """A capture or job: the request, its progress, and the status that was announced last in `told` ("new": none yet).

    `queue` is None where nothing is to be done. `restart` is {"stage", "attempt"} of a job told to begin again.
    """

    id: Id  # sorts by time
    kind: Annotated[Kind, String(8)]
    type: Annotated[str, String(32)]
    created: Moment
    request: dict[str, Any]
    rig: RigId | None = None
    capture: Id | None = None
    name: Name | None = None
    queue: Name | None = None
    priority: int = 0
    progress: dict[str, Any] = field(default_factory=dict)
    restart: dict[str, Any] | None = None
    told: Word = "new"
    note: Long | None = None


@dataclass(frozen=True)
class Event:
    """Something that happened to an entry at `at`, in seconds since 1970; `seq` grows in the order of visibility."""

    seq: int
    entry: Id
    at: float
    kind: Annotated[EventKind, String(16)]
    data: dict[str, Any]


@dataclass(frozen=True)
class StoredArtefact:
    """A file that a job has made."""

    entry: Id
    name: Annotated[str, String(200)]
    media_type: Name
    bytes: Bytes
    sha256: Sha256
    modified_ns: Annotated[str, String(24)]


@dataclass(frozen=True)
class UsedKey:
    """An Idempotency-Key, a digest of the request it came with, and the ids of the entries which that made."""

    key: Annotated[str, String(200)]
    digest: Sha256
    entries: list[str]
    at: float


@dataclass(frozen=True)
class Worker:
    """A worker; `token` belongs to one process, times are in seconds since 1970."""

    id: Name
    token: Annotated[str, String(32)]
    host: Name
    pid: int
    queues: list[str]
    started: float
    beat: float


@dataclass(frozen=True)
class KnownRig:
    """A rig of the service: `document` is the RIG.toml it was drawn in, `devices` the URI of its cameras."""

    id: RigId
    document: Long
    devices: Long


@dataclass(frozen=True)
class Found:
    """A calibration to be kept, and the job that found it."""

    source: Source
    report: dict[str, Any]
    job: str | None = None


@dataclass(frozen=True)
class StoredCalibration:
    """A version of a rig's calibration: `document` is its RIG.toml, `report` the account of how it was found.

    `created` is None for the rig as it was drawn, which nobody stores.
    """

    rig: RigId
    version: int
    created: Moment | None
    source: Annotated[Source, String(40)]
    job: Id | None
    sha256: Sha256
    document: Long
    report: dict[str, Any]

    @classmethod
    def of(cls, rig: str, version: int, created: str | None, found: Found, document: str) -> StoredCalibration:
        """Return `found` as version `version` of a rig's calibration."""
        sha256 = hashlib.sha256(document.encode()).hexdigest()
        return cls(rig, version, created, found.source, found.job, sha256, document, found.report)

    @property
    def poses(self) -> str:
        """Return whether its poses are `calibrated` or `nominal`."""
        return str(tomllib.loads(self.document)["poses"])


@dataclass(frozen=True)
class Current:
    """The version of a rig's calibration in use; `revision` counts every change, also back to an old version."""

    rig: RigId
    version: int = 0
    revision: int = 0


@dataclass(frozen=True)
class StoredUpload:
    """A file of `bytes` bytes; `name` is a label for people, and no path. An open one is still being sent."""

    id: Id
    created: Moment
    name: Name
    bytes: Bytes
    sha256: Sha256 | None
    state: Annotated[Literal["open", "committed"], String(12)] = "open"


@dataclass(frozen=True)
class StoredWebhook:
    """An address that is told when entries reach one of `statuses`; `secret` signs the messages."""

    id: Id
    created: Moment
    url: Long
    secret: Name
    statuses: list[str]


@dataclass(frozen=True)
class Delivery:
    """A message owed to a webhook, whole: its entry may be deleted before it arrives.

    `next` is when it is due or, once it is delivered or has failed, when it ended.
    """

    webhook: Id
    event: int
    body: Long
    attempts: int
    next: float
    status: Annotated[Literal["waiting", "delivered", "failed"], String(12)]
    said: Annotated[str, String(200)]


@dataclass(frozen=True)
class Token:
    """A token as it is kept; a viewer reads, an operator does everything."""

    id: Id
    digest: Sha256
    role: Annotated[Role, String(12)]
    name: Name
    created: Moment


entries = _table("entries", Entry, Index("entries_by_kind", "kind", "id"), Index("entries_by_told", "told"))
# With autoincrement a number is never given twice, so a client's last one stays meaningful.
events = _table("events", Event, Index("ix_events_entry", "entry"), key=("seq",), sqlite_autoincrement=True)
artefacts = _table("artefacts", StoredArtefact, key=("entry", "name"))
idempotency = _table("idempotency", UsedKey, key=("key",))
workers = _table("workers", Worker)
# A job finds one calibration of a rig.
calibrations = _table("calibrations", StoredCalibration, UniqueConstraint("rig", "job"), key=("rig", "version"))
current_calibrations = _table("current_calibrations", Current, key=("rig",))
known_rigs = _table("known_rigs", KnownRig)
uploads = _table("uploads", StoredUpload)
webhooks = _table("webhooks", StoredWebhook)
deliveries = _table("deliveries", Delivery, Index("deliveries_due", "status", "next"), key=("webhook", "event"))
tokens = _table("tokens", Token, UniqueConstraint("name"))
catalogue_format = Table("catalogue_format", metadata, Column("number", Integer, primary_key=True))
