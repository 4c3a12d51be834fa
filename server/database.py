"""The job engine's database, made or brought up to date before anything uses it."""

from __future__ import annotations

from dbos import DBOS
from sqlalchemy.exc import SQLAlchemyError

from server.errors import ServiceError
from server.settings import ServiceSettings


class DatabaseError(ServiceError):
    """A database that cannot be opened."""

    exit_code = 2


def prepare_database(settings: ServiceSettings) -> None:
    """Create or migrate the database: a client never does, and worker and web process start in any order.

    Raises DatabaseError naming the file.
    """
    settings.data.mkdir(parents=True, exist_ok=True)
    try:
        DBOS.migrate(settings.database_url)
    except SQLAlchemyError as error:
        reason = str(getattr(error, "orig", error)).splitlines()[0]
        raise DatabaseError(
            f"{settings.database_path}: found {reason}, expected the service's database; give another --data"
        ) from error
