"""The calibrations of rigs, by version, and which one is current. Version 0 is the rig as it was drawn."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal

import sqlalchemy as sa

from server.errors import NotFoundError, PreconditionError
from server.store.database import lock_writers
from server.store.entries import now
from server.store.tables import calibrations, current_calibrations

Source = Literal["nominal", "natural", "board", "pixels", "uploaded"]


@dataclass(frozen=True)
class StoredCalibration:
    """A calibration; `document` is its RIG.toml, `report` what was said when it was found."""

    rig: str
    version: int
    created: str
    source: Source
    job: str | None
    sha256: str
    document: str
    report: dict[str, Any]

    @classmethod
    def of(cls, rig: str, version: int, created: str, found: Found, document: str) -> StoredCalibration:
        """What was found, as a version."""
        sha256 = hashlib.sha256(document.encode()).hexdigest()
        return cls(rig, version, created, found.source, found.job, sha256, document, found.report)

    @property
    def poses(self) -> str:
        """Whether its poses are calibrated or nominal."""
        return str(tomllib.loads(self.document)["poses"])


@dataclass(frozen=True)
class Current:
    """The version in use; `revision` counts every change."""

    version: int = 0
    revision: int = 0


@dataclass(frozen=True)
class Found:
    """A calibration that is to be kept, and the job that found it."""

    source: Source
    report: dict[str, Any]
    job: str | None = None


class Calibrations:
    """The two tables of calibrations."""

    def __init__(self, engine: sa.Engine, clock: Callable[[], datetime] = now) -> None:
        self._engine = engine
        self._clock = clock

    def add(
        self,
        rig: str,
        found: Found,
        document: Callable[[str | None], str],
        *,
        apply: bool,
        expected: int | None = None,
    ) -> StoredCalibration:
        """Keep a new version and, where told to `apply` it, make it current; both or neither.

        `document` makes its RIG.toml out of the current one (None: as drawn). What a job found is kept once and applied
        once, however often it is told. Raises PreconditionError where the revision is not `expected`.
        """
        with self._engine.begin() as connection:
            lock_writers(connection)
            if found.job is not None:
                mine = sa.and_(calibrations.c.rig == rig, calibrations.c.job == found.job)
                known = connection.execute(sa.select(calibrations).where(mine)).mappings().first()
                if known is not None:
                    return StoredCalibration(**known)
            before = _current(connection, rig)
            _expect(rig, before, expected)
            newest = sa.select(sa.func.max(calibrations.c.version)).where(calibrations.c.rig == rig)
            base = _version(connection, rig, before.version)
            created = self._clock().isoformat("T", "milliseconds")
            version = (connection.scalar(newest) or 0) + 1
            stored = StoredCalibration.of(rig, version, created, found, document(base.document if base else None))
            connection.execute(calibrations.insert(), vars(stored))
            if apply:
                _set(connection, rig, Current(stored.version, before.revision + 1))
        return stored

    def apply(self, rig: str, version: int, expected: int | None = None) -> Current:
        """Make a version current; raises NotFoundError, and PreconditionError where the revision is not `expected`."""
        with self._engine.begin() as connection:
            lock_writers(connection)
            before = _current(connection, rig)
            _expect(rig, before, expected)
            if version and _version(connection, rig, version) is None:
                raise _unknown(rig, version)
            after = Current(version, before.revision + 1)
            _set(connection, rig, after)
        return after

    def current(self, rig: str) -> tuple[Current, StoredCalibration | None]:
        """The version in use and its calibration, None for the rig as it was drawn."""
        with self._engine.connect() as connection:
            found = _current(connection, rig)
            return found, _version(connection, rig, found.version)

    def get(self, rig: str, version: int) -> StoredCalibration:
        """One version; raises NotFoundError, also for 0, which nobody stored."""
        with self._engine.connect() as connection:
            found = _version(connection, rig, version)
        if found is None:
            raise _unknown(rig, version)
        return found

    def of(self, rig: str) -> list[StoredCalibration]:
        """All versions, newest first."""
        query = sa.select(calibrations).where(calibrations.c.rig == rig).order_by(calibrations.c.version.desc())
        with self._engine.connect() as connection:
            return [StoredCalibration(**row) for row in connection.execute(query).mappings()]


def _current(connection: sa.Connection, rig: str) -> Current:
    columns = current_calibrations.c
    query = sa.select(columns.version, columns.revision).where(columns.rig == rig)
    row = connection.execute(query).first()
    return Current(row.version, row.revision) if row else Current()


def _set(connection: sa.Connection, rig: str, current: Current) -> None:
    connection.execute(current_calibrations.delete().where(current_calibrations.c.rig == rig))
    connection.execute(current_calibrations.insert(), {"rig": rig} | vars(current))


def _version(connection: sa.Connection, rig: str, version: int) -> StoredCalibration | None:
    one = sa.and_(calibrations.c.rig == rig, calibrations.c.version == version)
    row = connection.execute(sa.select(calibrations).where(one)).mappings().first()
    return StoredCalibration(**row) if row else None


def _expect(rig: str, current: Current, expected: int | None) -> None:
    if expected is not None and current.revision != expected:
        raise PreconditionError(
            f"found the calibration of {rig} at revision {current.revision}",
            f"{expected} as If-Match has it",
            "look at it again before it is changed",
        )


def _unknown(rig: str, version: int) -> NotFoundError:
    return NotFoundError(
        f"found no calibration {version} of rig {rig}", f"one that GET /v1/rigs/{rig}/calibrations lists"
    )
