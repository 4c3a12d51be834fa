"""Tells a lost or damaged SQLite database from a sound one, and what to do about it."""

import logging
import sqlite3
from pathlib import Path

from server.errors import ServiceError
from server.settings import ServiceSettings

_BACKUP = "stop the service and its workers, then run spike4dgs restore"
_CURES = {  # of a file: what it has, a table of it, and what to do without a backup
    "dbos.sqlite": (
        "the job engine's database",
        "workflow_status",
        "or move it away: ended entries keep their end, the others begin again from their checkpoints",
    ),
    "catalogue.sqlite": ("the catalogue", "entries", "or move both databases away: recordings and runs stay as files"),
}
DATABASES = tuple(_CURES)
_LOG = logging.getLogger(__name__)


class DatabaseError(ServiceError):
    """A database that cannot be opened."""

    exit_code = 2


def expect_sound(settings: ServiceSettings) -> None:
    """Check the databases before they are opened, or created in a new data folder; raises DatabaseError.

    A job engine's that is missing is created anew, with a warning.
    """
    if settings.database is not None:
        return
    engine, catalogue = (settings.data / name for name in DATABASES)
    for path in (engine, catalogue):
        if path.exists():
            expect_whole(path)
    if engine.exists() and not catalogue.exists():
        raise _fault(catalogue, "gone")
    if catalogue.exists() and not engine.exists():
        _LOG.warning("%s is gone: a new one is made, ended entries keep their end, the others begin again", engine)


def expect_whole(path: Path) -> None:
    """Read through a database; raises DatabaseError where it is missing or damaged."""
    if not path.exists():
        raise _fault(path, "gone")
    _ask(path, "PRAGMA quick_check(1)", wanted=("ok",))


def expect_present(settings: ServiceSettings) -> None:
    """Check that the databases of a service at work are there, and are databases; raises DatabaseError."""
    for name, (_, table, _) in _CURES.items() if settings.database is None else ():
        if not (settings.data / name).exists():
            raise _fault(settings.data / name, "gone")
        _ask(settings.data / name, f"SELECT count(*) FROM (SELECT 1 FROM {table} LIMIT 1)")


def _ask(path: Path, query: str, wanted: tuple[str, ...] | None = None) -> None:
    connection = sqlite3.connect(path, timeout=30)
    try:
        answer = connection.execute(query).fetchone()
    except sqlite3.OperationalError as error:
        if "no such table" in str(error):
            raise _fault(path, "empty") from error
        raise _fault(path, str(error)) from error
    except sqlite3.DatabaseError as error:
        raise _fault(path, f"damaged ({error})") from error
    finally:
        connection.close()
    if wanted not in (None, answer):
        raise _fault(path, f"damaged ({answer[0].splitlines()[0]})")


def _fault(path: Path, found: str) -> DatabaseError:
    content, _, otherwise = _CURES[path.name]
    return DatabaseError(f"found {path.name} {found}", content, f"{_BACKUP}, {otherwise}", where=path.parent)
