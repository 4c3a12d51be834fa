"""Files written past the page cache: what a reservation takes and gives back."""

import ctypes
import errno
import types

import pytest

from acquisition.recording import direct
from acquisition.recording.direct import ALIGNMENT, DirectFile

BLOCK = 512  # bytes of one of `st_blocks`


@pytest.fixture
def file(tmp_path):
    opened = DirectFile(tmp_path / "cam00.dat")
    yield opened
    opened.abandon()


def taken(file: DirectFile) -> int:
    return file.path.stat().st_blocks * BLOCK


def test_a_reservation_takes_blocks_and_leaves_the_size(file):
    file.reserve(64 * ALIGNMENT)
    assert (file.reserved, file.path.stat().st_size) == (64 * ALIGNMENT, 0)
    assert taken(file) >= 64 * ALIGNMENT
    file.finish(0)
    assert taken(file) == 0


def test_a_disk_that_fills_up_while_space_is_reserved_gets_it_back(file, monkeypatch):
    """ext4 keeps the blocks it found before there were no more."""
    file.write(memoryview(bytes(ALIGNMENT)), 0)
    before, real = taken(file), direct._libc()

    def fallocate(handle: int, mode: int, first: int, size: int) -> int:
        assert real.fallocate(handle, mode, first, size // 2) == 0
        ctypes.set_errno(errno.ENOSPC)
        return -1

    monkeypatch.setattr(direct, "_libc", lambda: types.SimpleNamespace(fallocate=fallocate))
    with pytest.raises(OSError, match="No space left") as caught:
        file.reserve(64 * ALIGNMENT)
    assert caught.value.errno == errno.ENOSPC
    assert (file.reserved, taken(file)) == (0, before)
    assert file.path.read_bytes() == bytes(ALIGNMENT)
