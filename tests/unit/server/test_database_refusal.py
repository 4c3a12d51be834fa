"""A database that refuses is told in one line that says what to do."""

from pathlib import Path

import pytest
from sqlalchemy.exc import OperationalError

from server.settings import ServiceSettings
from server.store import database
from server.store.soundness import DatabaseError


@pytest.mark.parametrize(
    ("words", "do"),
    [
        ("connection failed: FATAL:  sorry, too many clients already", "raise max_connections of PostgreSQL"),
        ("FATAL:  password authentication failed", "give another --data or mend SPIKE4DGS_DATABASE"),
    ],
)
def test_a_refusal_says_what_to_do(words: str, do: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OperationalError("", None, Exception(words))

    monkeypatch.setattr(database, "_create_tables", refuse)
    with pytest.raises(DatabaseError) as refused:
        database.prepare_database(ServiceSettings(data=tmp_path), pause=lambda _: True)
    told = str(refused.value)
    assert words in told
    assert do in told
    assert "\n" not in told
