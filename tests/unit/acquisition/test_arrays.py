"""Tests that files of arrays come back as they were written, and that threads read them one after another."""

import time
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import numpy as np
import pytest

from acquisition.arrays import map_array, read_array, read_arrays, write_array

READERS = 4


@pytest.mark.parametrize("array", [np.zeros((0, 3)), np.asarray(7.5), np.arange(12, dtype=np.uint8).reshape(3, 4)])
def test_an_array_comes_back_as_it_was_written(array, tmp_path) -> None:
    write_array(tmp_path / "it.npy", array)
    for read in (read_array, map_array):
        found = read(tmp_path / "it.npy")
        assert found.dtype == array.dtype
        assert found.shape == array.shape
        assert np.array_equal(found, array)


def test_arrays_come_back_by_name(tmp_path) -> None:
    np.savez(tmp_path / "it.npz", a=np.arange(3), b=np.eye(2))
    found = read_arrays(tmp_path / "it.npz")
    assert sorted(found) == ["a", "b"]
    assert np.array_equal(found["b"], np.eye(2))


@pytest.mark.parametrize("read", [read_array, map_array])
def test_a_file_of_objects_is_refused(read, tmp_path) -> None:
    np.save(tmp_path / "it.npy", np.asarray([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match=r"allow_pickle|Python objects"):
        read(tmp_path / "it.npy")


def test_no_two_threads_parse_a_header_at_once(tmp_path, monkeypatch) -> None:
    write_array(tmp_path / "it.npy", np.arange(3))
    np.savez(tmp_path / "it.npz", a=np.arange(3))
    alone, load, met = Lock(), np.load, []

    def watched(*args, **kwargs):
        met.append(not alone.acquire(blocking=False))
        time.sleep(0.02)
        found = load(*args, **kwargs)
        if not met[-1]:
            alone.release()
        return found

    monkeypatch.setattr(np, "load", watched)
    reads = [(read_array, "it.npy"), (map_array, "it.npy"), (read_arrays, "it.npz")] * READERS
    with ThreadPoolExecutor(READERS) as pool:
        list(pool.map(lambda one: one[0](tmp_path / one[1]), reads))
    assert met == [False] * len(reads)
