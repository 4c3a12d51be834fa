"""The viewer of a long recording asks for parts of `viewer.bin`: each must be those bytes, of the same file."""

import hashlib

import pytest
from fastapi.testclient import TestClient

from server.services.services import Services
from server.store.tables import Entry

DATA = bytes(range(256)) * 40


@pytest.fixture
def address(services: Services) -> str:
    """The place of a finished job's `viewer.bin`."""
    entries = services.store.entries
    entry = Entry(entries.dated_id("j"), "job", "reconstruct", entries.now(), {}, capture="c1")  # type: ignore[arg-type]
    entries.add(entry)
    run = services.store.folder.run(entry.id)
    run.mkdir(parents=True)
    (run / "viewer.bin").write_bytes(DATA)
    services.store.artefacts.catalogue(entry.id, run, iter(["viewer.bin"]))
    return f"/v1/jobs/{entry.id}/artefacts/viewer.bin"


@pytest.mark.parametrize(("first", "last"), [(0, 0), (0, 4095), (1024, 5119), (len(DATA) - 4, len(DATA) - 1)])
def test_a_range_has_its_bytes_and_the_files_tag(http: TestClient, address: str, first: int, last: int) -> None:
    answer = http.get(address, headers={"Range": f"bytes={first}-{last}"})
    assert answer.status_code == 206
    assert answer.content == DATA[first : last + 1]
    assert answer.headers["Content-Range"] == f"bytes {first}-{last}/{len(DATA)}"
    assert answer.headers["Content-Length"] == str(last + 1 - first)
    assert answer.headers["ETag"] == f'"{hashlib.sha256(DATA).hexdigest()}"'


def test_a_known_range_is_not_sent_again(http: TestClient, address: str) -> None:
    tag = http.get(address, headers={"Range": "bytes=0-3"}).headers["ETag"]
    again = http.get(address, headers={"Range": "bytes=0-3", "If-None-Match": tag})
    assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", tag)


def test_a_range_beyond_the_file_is_refused_in_a_line(http: TestClient, address: str) -> None:
    answer = http.get(address, headers={"Range": f"bytes={len(DATA)}-{len(DATA) + 9}"})
    assert answer.status_code == 416
    assert f"within {len(DATA)} bytes" in answer.json()["detail"]
