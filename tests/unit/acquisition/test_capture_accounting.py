"""Whatever a camera sends and a ring refuses: every plane offered is written in its place, or lost and listed, once."""

import threading

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from maintenance.plain_camera import PlainCamera

from acquisition.devices.protocol import Block
from acquisition.errors import DeviceError
from acquisition.recording.manifest import Gap
from acquisition.session.capture import Capture, CaptureRules
from acquisition.spikes.layout import PlaneLayout

LAYOUT = PlaneLayout(32, 1)
RATE_HZ = 100.0  # so that a pre-trigger holds 25 planes more than it was asked for


class RandomRing:
    """Takes blocks as `takes` says, for ever the last; keeps every plane's number, -1 where it was lost."""

    layout, refusing = LAYOUT, "ring"

    def __init__(self, takes: list[bool]):
        self.takes, self.kept, self.listed, self.closed = takes, [], [], False

    @property
    def planes(self) -> int:
        return len(self.kept)

    @property
    def gaps(self) -> tuple[Gap, ...]:
        return tuple(self.listed)

    def offer(self, packed) -> bool:
        taken = self.takes.pop(0) if self.takes else True
        if taken:
            self.append(packed)
        return taken

    def append(self, packed) -> None:
        self.kept += np.ascontiguousarray(packed).view("<u4")[:, 0].tolist()

    def append_lost(self, gaps) -> None:
        for gap in gaps:
            assert gap.first_plane == self.planes  # in order, where it belongs
            self.kept += [-1] * gap.planes
            self.listed.append(gap)

    def close_keeping(self) -> None:
        self.closed = True


class Camera(PlainCamera):
    """Sends `steps` of (lost before, planes, repeated), saves after `save` of them, and is then unplugged."""

    id, layout = "cam00", LAYOUT

    def __init__(self, steps, save, on_save):
        super().__init__()
        self.blocks, self.at, self.dropped = [], 0, 0
        for lost, by_device, planes, repeated in steps:
            self.at += lost
            self.dropped += min(lost, by_device)
            numbers = np.arange(self.at, self.at + planes, dtype="<u4")
            block = Block(
                len(self.blocks), self.at, 0, LAYOUT, numbers.view(np.uint8).reshape(planes, 4), 1, self.dropped
            )
            self.blocks += [block, block] if repeated else [block]
            self.at += planes
        self.save, self.on_save, self.sent = save, on_save, 0

    def read_block(self, timeout_s):
        if self.sent == self.save:
            self.on_save()
        if self.sent == len(self.blocks):
            raise DeviceError("cam00: it is not connected any more")
        self.sent += 1
        return self.blocks[self.sent - 1]


step = st.tuples(st.sampled_from([0, 0, 0, 1, 17]), st.integers(0, 20), st.integers(1, 9), st.booleans())


@settings(max_examples=400)
@given(
    st.lists(step, max_size=40),
    st.lists(st.booleans(), max_size=60),
    st.none() | st.integers(0, 30),
    st.integers(0, 40),
    st.none() | st.integers(1, 200),
)
def test_offered_is_written_and_dropped_exactly(steps, takes, pre_planes, save, length):
    always = all(takes)
    ring = RandomRing(takes)
    began = []

    def begin():
        first = 0 if pre_planes is None else max(0, capture.position - pre_planes)
        if length is not None:
            capture.end_at(first + length)
        capture.begin_at(first)
        began.append(first)

    camera = Camera(steps, None if pre_planes is None else save, begin)
    capture = Capture(camera, ring, CaptureRules(RATE_HZ, pre_planes=pre_planes))
    if pre_planes is None:
        begin()
    capture.run(threading.Event())
    assert ring.closed
    if not began:
        assert ring.kept == []
        return
    first, last = began[0], capture.position if length is None else min(capture.position, began[0] + length)
    assert ring.planes == max(0, last - first)  # every plane offered has its place
    assert all(kept in (-1, first + place) for place, kept in enumerate(ring.kept))
    sent = {n for block in camera.blocks for n in range(block.first_plane, block.first_plane + len(block.packed))}
    never_sent = sum(n not in sent for n in range(first, last))
    lost = {layer: sum(g.planes for g in ring.gaps if g.layer == layer) for layer in ("device", "link", "ring")}
    assert ring.kept.count(-1) == sum(lost.values())
    assert lost["device"] <= camera.dropped
    assert lost["device"] + lost["link"] == never_sent
    assert not always or not lost["ring"]
