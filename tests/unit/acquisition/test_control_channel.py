"""Registers through a pair of bulk pipes: what is asked is answered, whatever else lies in the pipe."""

import errno
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from usb.core import USBError

from acquisition.devices.control_channel import (
    COMMAND_MAGIC,
    REPLY_MAGIC,
    Message,
    MessageChannel,
    MessageEnd,
    StallError,
)
from acquisition.devices.profiles.direct import DIRECT
from acquisition.devices.profiles.ft60x import FT60X
from acquisition.devices.registers import ClockRegister, LinkCounters, Request, Sensitivity
from acquisition.devices.usb_link import device_profile
from acquisition.errors import DeviceError

messages = st.builds(
    Message,
    st.sampled_from([COMMAND_MAGIC, REPLY_MAGIC]),
    st.integers(0, 255),
    st.integers(0, 255),
    st.integers(0, 65535),
    st.binary(max_size=64),
)


@given(messages)
def test_a_message_survives_the_wire(message):
    assert Message.decode(message.encode()) == message


@given(messages, st.data())
def test_a_damaged_or_cut_message_is_none(message, data):
    wire = bytearray(message.encode())
    assert Message.decode(bytes(wire[: data.draw(st.integers(0, len(wire) - 1))])) is None
    wire[data.draw(st.integers(0, len(wire) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert Message.decode(bytes(wire)) is None


@given(st.binary(max_size=200))
def test_nonsense_is_none_and_gets_no_answer(data):
    end = MessageEnd(FT60X, lambda request: b"", lambda request, given: None)
    end.take(FT60X.command_endpoint, data)
    assert Message.decode(data) is None
    assert end.give(FT60X.reply_endpoint) == b""


class Pipes:
    """A camera behind two pipes; `junk` lies before its replies."""

    def __init__(self, junk: list[bytes]):
        self.junk, self.done = junk, []
        self.end = MessageEnd(FT60X, self.register, self.do)

    def register(self, request: int) -> bytes:
        if request == Request.STATUS:
            raise StallError
        return bytes([request] * 64)

    def do(self, request: int, data: bytes) -> None:
        if request == Request.START:
            raise StallError
        self.done.append((request, data))

    def write(self, endpoint, data, timeout_s):
        assert endpoint == FT60X.command_endpoint
        self.end.take(endpoint, data)

    def read(self, endpoint, size, timeout_s):
        assert endpoint == FT60X.reply_endpoint
        return self.junk.pop() if self.junk else self.end.give(endpoint)


def test_stale_and_damaged_replies_are_passed_over():
    stale = Message(REPLY_MAGIC, Request.LINK, 0, 7, b"old").encode()
    pipes = Pipes([stale, b"", b"nonsense", Message(COMMAND_MAGIC, Request.LINK, 0, 1, b"echo").encode()])
    channel = MessageChannel(pipes, FT60X)
    assert channel.read(Request.LINK) == bytes([Request.LINK] * 64)
    assert channel.read(Request.CLOCK) == bytes([Request.CLOCK] * 64)
    channel.write(Request.SET_SENSITIVITY, b"12345678")
    assert pipes.done == [(Request.SET_SENSITIVITY, b"12345678")]


@pytest.mark.parametrize("ask", [lambda c: c.read(Request.STATUS), lambda c: c.write(Request.START)])
def test_what_is_refused_is_a_stall(ask):
    with pytest.raises(USBError) as caught:
        ask(MessageChannel(Pipes([]), FT60X))
    assert caught.value.errno == errno.EPIPE


def test_a_pipe_full_of_nonsense_ends():
    pipes = Pipes([b"x"] * 1000)
    with pytest.raises(USBError) as caught:
        MessageChannel(pipes, FT60X).read(Request.LINK)
    assert caught.value.errno == errno.EIO
    assert len(pipes.junk) == 1000 - 64


def test_profiles_are_told_by_their_identifiers():
    found = [device_profile(SimpleNamespace(idVendor=v, idProduct=p)) for v, p in ((0x0403, 0x601F), (0x1209, 0x0001))]
    assert found == [FT60X, DIRECT]
    assert device_profile(SimpleNamespace(idVendor=0x1209, idProduct=0x0002)) is None  # the trigger box
    assert (DIRECT.queued_mb, FT60X.queued_mb) == (8, 4)


@pytest.mark.parametrize(
    "register", [Sensitivity(250, 1), ClockRegister(5, None), ClockRegister(9, 4), LinkCounters(1, 2, 3)]
)
def test_the_new_registers_round_trip(register):
    assert type(register).decode(register.encode()) == register
    with pytest.raises(DeviceError, match="expected"):
        type(register).decode(register.encode()[:-1])


@pytest.mark.parametrize(
    ("values", "found"), [((249, 1000), "threshold 249"), ((1000, 0), "exposure 0"), ((1000, 1001), "exposure 1001")]
)
def test_wild_values_are_refused(values, found):
    with pytest.raises(DeviceError, match=f"found the {found}, expected"):
        Sensitivity(*values).refuse_wild()
    with pytest.raises(DeviceError, match=found):
        Sensitivity.decode(Sensitivity(*values).encode())


def test_link_counters_tell_what_came_since():
    assert LinkCounters(5, 2, 1).since(LinkCounters(3, 2, 0)) == LinkCounters(2, 0, 1)
    assert LinkCounters(1, 0, 0).since(LinkCounters(3, 2, 0)) == LinkCounters(1, 0, 0)  # powered up anew
