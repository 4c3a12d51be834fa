"""Brings the catalogue of an older service up to date, and refuses one of a newer."""

import json
from collections.abc import Callable

import sqlalchemy as sa

from server.store.soundness import DatabaseError
from server.store.tables import catalogue_format, entries, metadata

Step = Callable[[sa.Connection], None]


def _rename_variation(connection: sa.Connection) -> None:
    """Give the supervision that compares images its name of today in the requests of jobs."""
    asked = connection.execute(sa.select(entries.c.id, sa.cast(entries.c.request, sa.Text))).all()
    for entry_id, text in asked:
        request = json.loads(text)
        if request.get("supervision") == "variation":
            request["supervision"] = "image-variation"
            connection.execute(entries.update().where(entries.c.id == entry_id).values(request=request))


def _add_notes(connection: sa.Connection) -> None:
    """Give captures and jobs room for a person's note."""
    connection.exec_driver_sql("ALTER TABLE entries ADD COLUMN note TEXT")


STEPS: tuple[Step, ...] = (_rename_variation, _add_notes)  # from format 1 to 2, from 2 to 3 ...
FORMAT = 1 + len(STEPS)


def migrate(connection: sa.Connection, name: str) -> None:
    """Create the tables, or take those of an older service to today's format, one step after the other.

    The format is noted since the second. Call it in the transaction that alone may write. Raises DatabaseError naming
    the database `name` where it is newer.
    """
    is_new = not sa.inspect(connection).has_table(entries.name)
    metadata.create_all(connection)
    noted = connection.scalar(sa.select(catalogue_format.c.number))
    found = noted or (FORMAT if is_new else 1)
    if found > FORMAT:
        raise DatabaseError(
            f"found its format to be {found}, of a later version", f"at most {FORMAT}", "use that version", where=name
        )
    for step in STEPS[found - 1 :]:
        step(connection)
    if noted != FORMAT:
        connection.execute(catalogue_format.delete())
        connection.execute(catalogue_format.insert().values(number=FORMAT))
