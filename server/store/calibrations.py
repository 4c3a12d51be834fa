"""The calibrations of rigs, by version, and which one is current. Version 0 is the rig as it was drawn."""

from collections.abc import Callable

import sqlalchemy as sa

from server.errors import NotFoundError, PreconditionError
from server.store.records import Records
from server.store.tables import Current, Found, StoredCalibration, calibrations, current_calibrations


class Calibrations(Records[StoredCalibration]):
    """The two tables of calibrations."""

    table, row = calibrations, StoredCalibration

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
        once, however often this is called. Raises PreconditionError where the revision is not `expected`.
        """
        with self.writing() as connection:
            if found.job is not None:
                known = self.rows(connection, calibrations.c.rig == rig, calibrations.c.job == found.job)
                if known:
                    return known[0]
            before = _expected(connection, rig, expected)
            newest = sa.select(sa.func.max(calibrations.c.version)).where(calibrations.c.rig == rig)
            base = self._version(connection, rig, before.version)
            version = (connection.scalar(newest) or 0) + 1
            stored = StoredCalibration.of(rig, version, self.now(), found, document(base.document if base else None))
            connection.execute(calibrations.insert(), vars(stored))
            if apply:
                _set(connection, Current(rig, stored.version, before.revision + 1))
        return stored

    def apply(self, rig: str, version: int, expected: int | None = None) -> Current:
        """Make a version current; raises NotFoundError, and PreconditionError where the revision is not `expected`."""
        with self.writing() as connection:
            before = _expected(connection, rig, expected)
            if version and self._version(connection, rig, version) is None:
                raise _unknown(rig, version)
            after = Current(rig, version, before.revision + 1)
            _set(connection, after)
        return after

    def current(self, rig: str) -> tuple[Current, StoredCalibration | None]:
        """Return the version in use and its calibration, None for the rig as it was drawn."""
        with self._engine.connect() as connection:
            found = _current(connection, rig)
            return found, self._version(connection, rig, found.version)

    def get(self, rig: str, version: int) -> StoredCalibration:
        """Return one version; raises NotFoundError, also for 0, which nobody stored."""
        with self._engine.connect() as connection:
            found = self._version(connection, rig, version)
        if found is None:
            raise _unknown(rig, version)
        return found

    def of(self, rig: str) -> list[StoredCalibration]:
        """Return all versions, newest first."""
        return self.select(calibrations.c.rig == rig, order=calibrations.c.version.desc())

    def _version(self, connection: sa.Connection, rig: str, version: int) -> StoredCalibration | None:
        found = self.rows(connection, calibrations.c.rig == rig, calibrations.c.version == version)
        return found[0] if found else None


def _current(connection: sa.Connection, rig: str) -> Current:
    query = sa.select(current_calibrations).where(current_calibrations.c.rig == rig)
    row = connection.execute(query).mappings().first()
    return Current(**row) if row else Current(rig)


def _set(connection: sa.Connection, current: Current) -> None:
    connection.execute(current_calibrations.delete().where(current_calibrations.c.rig == current.rig))
    connection.execute(current_calibrations.insert(), vars(current))


def _expected(connection: sa.Connection, rig: str, revision: int | None) -> Current:
    current = _current(connection, rig)
    if revision is not None and current.revision != revision:
        raise PreconditionError(
            f"found the calibration of {rig} at revision {current.revision}",
            f"{revision} as If-Match has it",
            "look at it again before it is changed",
        )
    return current


def _unknown(rig: str, version: int) -> NotFoundError:
    return NotFoundError(
        f"found no calibration {version} of rig {rig}", f"one that GET /v1/rigs/{rig}/calibrations lists"
    )
