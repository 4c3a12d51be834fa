import threading
import time

import numpy as np
import pytest
import torch

from acquisition.native import code_path, code_paths, load_library
from reconstruction.native import kernels_alone, shared_out, threads


@pytest.fixture
def three_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("three_threads")
def test_results_come_in_the_order_of_the_items_and_at_once():
    together = threading.Barrier(3, timeout=20)  # broken unless three items are at work at the same time

    def work(item):
        together.wait()
        return item * item

    assert list(shared_out(work, range(9))) == [item * item for item in range(9)]


@pytest.mark.usefixtures("three_threads")
@pytest.mark.parametrize("alone", [False, True])
def test_each_item_has_one_thread_and_the_caller_has_its_own_again(alone):
    def work(_):
        return threads(), torch.get_num_threads(), torch.empty(0).new_ones(9).sum().item()

    if alone:
        with kernels_alone():
            assert list(shared_out(work, range(7))) == [(1, 1, 9.0)] * 7
            assert (threads(), torch.get_num_threads()) == (3, 1)
    else:
        assert list(shared_out(work, range(7))) == [(1, 1, 9.0)] * 7
    assert (threads(), torch.get_num_threads()) == (3, 3)
    assert list(shared_out(work, [])) == []


@pytest.mark.parametrize(("most", "shared"), [(1, 4), (2, 2), (3, 1), (9, 1)])
def test_fewer_at_a_time_share_the_threads(most, shared):
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    lock, at_work, seen = threading.Lock(), [0], []

    def work(_):
        with lock:
            at_work[0] += 1
            seen.append(at_work[0])
        time.sleep(0.01)
        with lock:
            at_work[0] -= 1
        return threads()

    try:
        assert list(shared_out(work, range(8), most)) == [shared] * 8
        assert threads() == 4
    finally:
        torch.set_num_threads(before)
    assert max(seen) <= most


@pytest.mark.usefixtures("three_threads")
def test_an_error_reaches_the_caller_and_ends_the_work():
    begun = []

    def work(item):
        begun.append(item)
        if item == 1:
            raise ValueError("found one")
        return item

    found = []
    with pytest.raises(ValueError, match="found one"):
        found.extend(shared_out(work, range(1000)))
    assert len(begun) <= 5  # those that were under way
    assert threads() == 3


@pytest.mark.usefixtures("three_threads")
def test_a_caller_who_stops_early_leaves_nothing_behind():
    results = shared_out(lambda item: item, iter(range(1000)))
    assert [next(results), next(results)] == [0, 1]
    results.close()
    assert torch.get_num_threads() == 3
    assert not [one for one in threading.enumerate() if one.name.startswith("shared")]


@pytest.mark.usefixtures("three_threads")
def test_the_build_that_was_chosen_is_every_items():
    def build(_):
        return load_library("reconstruction")._name

    for name in code_paths():
        with code_path(name):
            assert set(shared_out(build, range(5))) == {build(None)}


def test_pictures_do_not_depend_on_the_number_of_threads(scene_with):
    scene, seen = scene_with("linear"), []
    before = torch.get_num_threads()
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            seen.append(list(shared_out(lambda u: scene.cloud.look(scene.rig.cameras[0], u), [0.001, 0.002, 0.003])))
    finally:
        torch.set_num_threads(before)
    for views in seen[1:]:
        for one, other in zip(seen[0], views, strict=True):
            assert np.array_equal(one.intensity, other.intensity)
            assert np.array_equal(one.depth, other.depth, equal_nan=True)
