"""Tests the stream against a pipe's answers, one by one."""

import errno
from collections import deque

import pytest
from usb.core import USBError

from acquisition.devices.stream import BulkStream, Completion, Outcome


class Script:
    """A pipe that answers as it was told; out of answers, it waits for the whole time."""

    def __init__(self, *answers: tuple[Outcome, bytes], room: int = 8):
        self.answers, self.room = deque(answers), room
        self.flying = self.most = self.halts_cleared = 0
        self.now_s = 0.0
        self.cancelled = False

    def submit(self) -> None:
        if self.flying == self.room:
            raise USBError("Insufficient memory", -11, errno.ENOMEM)
        self.flying += 1
        self.most = max(self.most, self.flying)

    def reap(self, timeout_s: float) -> Completion | None:
        if self.cancelled or self.answers:
            self.flying -= 1
            outcome, data = self.answers.popleft() if self.answers else (Outcome.CANCELLED, b"")
            self.cancelled = self.cancelled and self.flying > 0
            return Completion(outcome, memoryview(data))
        self.now_s += timeout_s
        return None

    def cancel(self) -> None:
        self.cancelled = self.flying > 0

    def clear_halt(self) -> None:
        self.halts_cleared += 1

    def close(self) -> None:
        self.closed = True


def stream_of(pipe: Script) -> BulkStream:
    stream = BulkStream(pipe, clock=lambda: pipe.now_s)
    stream.start()
    return stream


def test_eight_transfers_stay_in_flight():
    pipe = Script(*[(Outcome.DONE, b"x")] * 20)
    stream = stream_of(pipe)
    assert b"".join(bytes(stream.read(1)) for _ in range(20)) == b"x" * 20
    assert (pipe.most, pipe.flying) == (8, 7)  # the last one is queued again by the next read


def test_nothing_in_time_is_empty():
    pipe = Script()
    assert stream_of(pipe).read(0.5) == b""
    assert pipe.now_s == pytest.approx(0.5)


def test_bytes_that_cancelled_transfers_had_got_come_in_order():
    pipe = Script()
    stream = stream_of(pipe)
    pipe.cancel = lambda: (
        pipe.answers.extend([(Outcome.CANCELLED, b"ab"), (Outcome.CANCELLED, b"c")]),
        setattr(pipe, "cancelled", True),
    )
    assert [bytes(stream.read(0.5)) for _ in range(2)] == [b"ab", b"c"]


def test_a_stall_keeps_what_came_and_is_cleared():
    pipe = Script((Outcome.STALLED, b"part"), *[(Outcome.STALLED, b"")] * 7, (Outcome.DONE, b"next"))
    stream = stream_of(pipe)
    assert [bytes(stream.read(1)) for _ in range(3)] == [b"", b"part", b"next"]
    assert pipe.halts_cleared == 1


def test_a_device_that_is_gone_stays_gone():
    pipe = Script((Outcome.GONE, b""))
    stream = stream_of(pipe)
    with pytest.raises(USBError) as caught:
        stream.read(600)
    assert caught.value.errno == errno.ENODEV
    stream.close()
    assert pipe.closed


@pytest.mark.parametrize("room", [0, 3])
def test_a_full_kernel_leaves_nothing_in_flight(room):
    pipe = Script(room=room)
    with pytest.raises(USBError) as caught:
        stream_of(pipe)
    assert caught.value.errno == errno.ENOMEM
    assert pipe.flying == 0


def test_a_transfer_the_kernel_never_gives_back_is_an_error_and_no_hang():
    pipe = Script()
    stream = stream_of(pipe)
    pipe.cancel = lambda: None
    with pytest.raises(USBError) as caught:
        stream.stop()
    assert caught.value.errno == errno.ETIMEDOUT
