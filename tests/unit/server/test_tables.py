"""A database that an earlier service wrote is read by this one: its tables have the columns of the first release."""

import sqlite3
from pathlib import Path

import pytest

from server.settings import ServiceSettings
from server.store.store import Store
from server.store.tables import Entry, metadata

COLUMNS = {
    "known_rigs": "devices document id",
    "artefacts": "bytes entry media_type modified_ns name sha256",
    "catalogue_format": "number",
    "calibrations": "created document job report rig sha256 source version",
    "current_calibrations": "revision rig version",
    "deliveries": "attempts body event next said status webhook",
    "entries": "capture created id kind name note priority progress queue request restart rig told type",
    "events": "at data entry kind seq",
    "idempotency": "at digest entries key",
    "tokens": "created digest id name role",
    "uploads": "bytes created id name sha256 state",
    "webhooks": "created id secret statuses url",
    "workers": "beat host id pid queues started token",
}
KEYS = {
    "artefacts": "entry name",
    "calibrations": "rig version",
    "current_calibrations": "rig",
    "deliveries": "event webhook",
    "entries": "id",
    "events": "seq",
    "idempotency": "key",
    "known_rigs": "id",
    "catalogue_format": "number",
    "tokens": "id",
    "uploads": "id",
    "webhooks": "id",
    "workers": "id",
}


@pytest.mark.parametrize("name", COLUMNS)
def test_a_table_has_the_columns_of_every_release(name: str) -> None:
    table = metadata.tables[name]
    assert sorted(column.name for column in table.columns) == COLUMNS[name].split()
    assert sorted(column.name for column in table.primary_key) == KEYS[name].split()


def test_there_is_no_other_table() -> None:
    assert metadata.tables.keys() == COLUMNS.keys()


def test_an_optional_field_may_be_null_and_no_other(tmp_path: Path) -> None:
    store = Store(ServiceSettings(data=tmp_path))
    entry = Entry("j20260101-000000-00000000", "job", "verify", store.entries.now(), {})
    assert store.entries.add(entry)
    assert not store.entries.add(entry)
    assert store.entries.get("job", entry.id) == entry
    store.close()
    with sqlite3.connect(tmp_path / "catalogue.sqlite") as connection:
        columns = {row[1]: row[3] for row in connection.execute("PRAGMA table_info(entries)")}
    optional = {name for name, not_null in columns.items() if not not_null}
    assert optional == {"rig", "capture", "name", "queue", "restart", "note"}
