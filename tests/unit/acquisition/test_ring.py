"""Bytes through the ring are the bytes that were put, with zeros where some were skipped."""

import threading

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from acquisition.recording.ring import ChunkRing

CHUNK = 4096
steps = st.lists(st.tuples(st.sampled_from(["offer", "skip", "take"]), st.integers(0, 3 * CHUNK)), max_size=40)


class Taker:
    """Writes chunks into memory, as the file would hold them."""

    def __init__(self, ring: ChunkRing):
        self.ring = ring
        self.file = np.full(1 << 20, 0, dtype=np.uint8)

    def take(self) -> bool:
        chunk = self.ring.take()
        if chunk is None:
            return False
        data = self.ring.data(chunk, 512)
        self.file[chunk.offset : chunk.offset + len(data)] = np.frombuffer(data, dtype=np.uint8)
        self.ring.give_back(chunk)
        return True


@given(steps)
def test_what_was_taken_is_there_and_what_was_skipped_is_zero(steps):
    ring = ChunkRing(4, CHUNK)
    taker = Taker(ring)
    expected = np.zeros(1 << 20, dtype=np.uint8)
    rng = np.random.default_rng(0)
    for step, size in steps:
        at = ring.position
        if step == "offer" and size:
            data = rng.integers(1, 256, size, dtype=np.uint8)
            if ring.offer(data):
                expected[at : at + size] = data
                assert ring.position == at + size
            else:
                assert ring.position == at
        elif step == "skip":
            ring.skip(size)
            assert ring.position == at + size
        elif ring._ready:
            taker.take()
    end = ring.position
    ring.close()
    while taker.take():
        pass
    np.testing.assert_array_equal(taker.file[:end], expected[:end])
    assert not taker.file[end:].any()


def test_a_full_ring_takes_nothing_and_says_so():
    ring = ChunkRing(4, CHUNK)
    block = np.ones(3 * CHUNK // 2, dtype=np.uint8)
    assert [ring.offer(block) for _ in range(4)] == [True, True, False, False]
    assert ring.fullness == 0.75
    assert ring.offer(block[: CHUNK // 2])
    assert not ring.offer(block)
    ring.skip(100 * CHUNK)  # never waits, and takes no room
    assert not ring.offer(np.ones(CHUNK + 1, dtype=np.uint8))
    assert ring.position == 100 * CHUNK + 7 * CHUNK // 2


def test_put_waits_for_room_and_ends_when_the_writer_refuses():
    ring = ChunkRing(2, CHUNK)
    done = []
    thread = threading.Thread(target=lambda: done.append(ring.put(np.ones(8 * CHUNK, dtype=np.uint8))))
    thread.start()
    taker = Taker(ring)
    for _ in range(3):
        assert taker.take()
    ring.refuse()
    thread.join()
    assert done == [False]
