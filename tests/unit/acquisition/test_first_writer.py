"""Files that the first of several processes writes."""

import errno
import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from acquisition.durable import write_first
from acquisition.errors import DiskError


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "folder"
    made.mkdir()
    number = os.open(made, os.O_RDONLY)
    yield number, made
    os.close(number)


def refuse(number):
    def link(*arguments, **how):
        raise OSError(number, os.strerror(number))

    return link


@pytest.mark.parametrize("data", [b"", b"x", bytes(10**6)])
def test_the_first_writes_and_the_second_does_not(folder, data):
    assert write_first(folder[0], "a", data)
    assert not write_first(folder[0], "a", b"other")
    assert (folder[1] / "a").read_bytes() == data
    assert [path.name for path in folder[1].iterdir()] == ["a"]


def test_of_many_at_once_one_is_the_first(folder):
    contents = [bytes([i]) * 1000 for i in range(40)]
    with ThreadPoolExecutor(8) as pool:
        firsts = list(pool.map(lambda data: write_first(folder[0], "a", data), contents))
    assert firsts.count(True) == 1
    assert (folder[1] / "a").read_bytes() == contents[firsts.index(True)]


def test_a_folder_that_was_removed_takes_nothing(folder):
    folder[1].rmdir()
    folder[1].mkdir()
    assert not write_first(folder[0], "a", b"late")
    assert list(folder[1].iterdir()) == []


def test_a_lost_answer_is_told_from_a_name_that_is_taken(folder, monkeypatch):
    link = os.link

    def lost(*names, **folders):
        link(*names, **folders)
        raise FileExistsError(errno.EEXIST, "asked twice")

    monkeypatch.setattr(os, "link", lost)
    assert write_first(folder[0], "a", b"mine")
    assert not write_first(folder[0], "a", b"other")
    assert (folder[1] / "a").read_bytes() == b"mine"


def test_a_disk_without_links_will_do(folder, monkeypatch):
    monkeypatch.setattr(os, "link", refuse(errno.EPERM))
    assert write_first(folder[0], "a", b"mine")
    assert not write_first(folder[0], "a", b"other")
    assert (folder[1] / "a").read_bytes() == b"mine"
    assert [path.name for path in folder[1].iterdir()] == ["a"]


def test_a_full_disk_is_said_and_leaves_nothing(folder, monkeypatch):
    monkeypatch.setattr(os, "fsync", refuse(errno.ENOSPC))
    with pytest.raises(DiskError, match=r"No space left on device.*room and permission for 4 bytes"):
        write_first(folder[0], "a", b"data")
    assert list(folder[1].iterdir()) == []
