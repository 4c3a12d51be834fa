"""What a page says of where its rows were measured."""

from acquisition.bench_document import machines_of, revisions_of

DOCUMENT = {"device": {"processor": "new chip", "threads": 2}, "revision": "new"}
OLDER = {"processor": "old chip", "threads": 4, "revision": "old", "asked": "0123"}


def test_runs_of_cells_name_their_own_machine_and_revision_and_other_rows_the_documents():
    assert machines_of(DOCUMENT, [OLDER]) == "old chip, 4 threads"
    assert revisions_of(DOCUMENT, [OLDER]) == "revision old"
    newer = OLDER | DOCUMENT["device"] | {"revision": "new"}
    assert machines_of(DOCUMENT, [OLDER, newer]) == "new chip, 2 threads; old chip, 4 threads"
    assert revisions_of(DOCUMENT, [OLDER, newer]) == "revisions new, old"
    for rows in ([], [{"revision": "of a rival"}]):
        assert machines_of(DOCUMENT, rows) == "new chip, 2 threads"
        assert revisions_of(DOCUMENT, rows) == "revision new"
