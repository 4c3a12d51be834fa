"""The parts a stream's writer is made of: its digests and its losses."""

import numpy as np
import pytest
import xxhash
from hypothesis import given
from hypothesis import strategies as st

from acquisition.recording.digests import BlockDigests
from acquisition.recording.losses import Losses, clip_gaps
from acquisition.recording.manifest import Gap

PLANE_BYTES, BLOCK_PLANES = 6, 8


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 30)), min_size=1, max_size=6))
def test_digests_do_not_depend_on_the_cuts_and_know_zeros(parts):
    ended, data = [], []
    digests = BlockDigests(BLOCK_PLANES, PLANE_BYTES, lambda *block: ended.append(block))
    for number, (lost, planes) in enumerate(parts):
        data.append(np.full((planes, PLANE_BYTES), 0 if lost else number + 1, np.uint8))
        if lost:
            digests.add_zeros(planes)
        else:
            digests.add(data[-1])
    digests.finish()
    whole = np.concatenate(data)
    blocks = [whole[i : i + BLOCK_PLANES] for i in range(0, len(whole), BLOCK_PLANES)]
    assert digests.planes == len(whole)
    assert digests.digests == [xxhash.xxh3_64_hexdigest(block.tobytes()) for block in blocks]
    assert ended == [(n, len(b), d) for n, (b, d) in enumerate(zip(blocks, digests.digests, strict=True))]


def test_digests_keep_only_whole_blocks():
    digests = BlockDigests(BLOCK_PLANES, PLANE_BYTES, lambda *block: None)
    digests.add(np.ones((3 * BLOCK_PLANES, PLANE_BYTES), np.uint8))
    digests.keep(2 * BLOCK_PLANES + 5)
    assert len(digests.digests) == 2


def test_neighbouring_losses_of_one_layer_are_one_gap():
    losses = Losses()
    for gap in (Gap(2, 3, "ring"), Gap(5, 1, "ring"), Gap(6, 2, "link"), Gap(9, 1, "link")):
        losses.add(gap)
    assert losses.gaps == [Gap(2, 4, "ring"), Gap(6, 2, "link"), Gap(9, 1, "link")]
    assert clip_gaps(losses.gaps, 7) == (Gap(2, 4, "ring"), Gap(6, 1, "link"))


@pytest.mark.parametrize(
    ("kept", "expected"),
    [
        (0, [Gap(0, 2, "disk"), Gap(2, 4, "ring"), Gap(6, 4, "disk")]),
        (4, [Gap(2, 2, "ring"), Gap(4, 2, "ring"), Gap(6, 4, "disk")]),
        (8, [Gap(2, 4, "ring"), Gap(8, 2, "disk")]),
        (10, [Gap(2, 4, "ring")]),
    ],
)
def test_what_the_disk_refused_is_lost_there_unless_it_was_lost_before(kept, expected):
    losses = Losses()
    losses.add(Gap(2, 4, "ring"))
    losses.refuse(kept, 10)
    assert losses.gaps == expected
