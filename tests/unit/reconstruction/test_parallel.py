import threading
import time

import pytest

from reconstruction.parallel import each


def test_results_come_in_the_order_of_the_items():
    def late(i):
        time.sleep(0.02 if i == 0 else 0)
        return i * i

    assert list(each(late, range(9))) == [i * i for i in range(9)]
    assert list(each(late, [])) == []


def test_what_the_work_raises_is_raised_and_the_rest_is_left():
    begun = threading.Semaphore(0)

    def fail(i):
        begun.release()
        if i == 0:
            raise ValueError("found nothing")
        time.sleep(0.01)

    with pytest.raises(ValueError, match="found nothing"):
        list(each(fail, range(500)))
    assert sum(begun.acquire(blocking=False) for _ in range(500)) < 250


def test_a_caller_that_stops_leaves_the_rest():
    done = []
    for i in each(lambda i: done.append(i) or time.sleep(0.005), range(500)):
        assert i is None
        break
    assert len(done) < 250
