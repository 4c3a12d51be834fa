"""Keeps transfers of one camera in flight over a narrow pipe, which both libusb and the mock implement."""

import contextlib
import enum
import errno
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import usb.core
from usb.core import USBError, USBTimeoutError

_COLLECT_S = 2.0  # seconds after which a kernel will never give a cancelled transfer back


class Outcome(enum.Enum):
    """The end of a transfer, which may have brought bytes all the same."""

    DONE = "done"  # full, or ended by a short packet
    CANCELLED = "cancelled"
    STALLED = "stalled"
    GONE = "gone"
    FAILED = "failed"


class Completion(NamedTuple):
    """A transfer that ended; `data` is valid until the next submit."""

    outcome: Outcome
    data: memoryview


def device_gone() -> USBError:
    """Return the error of a device that was unplugged."""
    return USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def pipe_stalled() -> USBError:
    """Return the error of a pipe that is halted, or of a request that is refused."""
    return USBError("Pipe error", -9, errno.EPIPE)


def timed_out() -> USBTimeoutError:
    """Return the error of a transfer that did not end in time."""
    return USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)


class StreamPipe(Protocol):
    """Transfers of one endpoint, given back in the order of submission.

    Errors are pyusb's, with the kernel's errno.
    """

    def submit(self) -> None:
        """Queue one more transfer; raises USBError: ENOMEM past the kernel's limit, ENODEV for a device gone."""
        ...

    def reap(self, timeout_s: float) -> Completion | None:
        """Return the oldest transfer, or None when it does not end within `timeout_s`."""
        ...

    def cancel(self) -> None:
        """Ask for all transfers to end now; `reap` gives each back, with the bytes it had got."""
        ...

    def clear_halt(self) -> None:
        """End a stall."""
        ...

    def write(self, endpoint: int, data: bytes, timeout_s: float) -> None:
        """Send all of `data` to another endpoint of the same interface, waiting."""
        ...

    def read(self, endpoint: int, size: int, timeout_s: float) -> bytes:
        """Return what comes from another endpoint, up to a short packet or `size` bytes, waiting."""
        ...

    def close(self) -> None:
        """Give the device back; what is in flight is lost."""
        ...


@runtime_checkable
class StreamingBackend(Protocol):
    """A pyusb backend that has stream pipes of its own."""

    def open_stream(self, device: usb.core.Device) -> StreamPipe:
        """Return the stream of `device`, which must be free."""
        ...


class BulkStream:
    """Reads a pipe with `in_flight` transfers always queued, so that the device never waits for the host."""

    def __init__(self, pipe: StreamPipe, in_flight: int = 8, clock: Callable[[], float] = time.monotonic):
        self._pipe = pipe
        self._in_flight = in_flight
        self._clock = clock
        self._queued = 0
        self._ready: deque[bytes] = deque()
        self._running = False

    def start(self) -> None:
        """Queue the transfers, none of an earlier run among them; raises USBError, and then none are queued."""
        self.stop()
        self._running = True
        self._fill()

    def stop(self) -> None:
        """End all transfers and forget what they brought."""
        self._running = False
        self._collect()
        self._ready.clear()

    def read(self, timeout_s: float) -> bytes | memoryview:
        """Return the next bytes, valid until the next call; none when `timeout_s` passes without any, or after a stall.

        A transfer that is not full when the time is over gives what it has. A stall is cleared and costs nothing.
        Raises USBError: ENODEV for a device gone, ENOMEM for a full kernel.
        """
        if self._ready:
            return self._ready.popleft()
        if not self._running:
            return b""
        self._fill()
        deadline_s = self._clock() + timeout_s
        while (left_s := deadline_s - self._clock()) > 0:
            completion = self._reap(left_s)
            if completion is None:
                break
            if completion.outcome is Outcome.STALLED:
                return self._recover(completion)
            if completion.data:
                return completion.data
            self._fill()
        self._collect()
        return self._ready.popleft() if self._ready else b""

    def close(self) -> None:
        """Give the device back."""
        self._running = False
        with contextlib.suppress(USBError):  # it is gone, and its transfers with it
            self._collect()
        self._pipe.close()

    def _fill(self) -> None:
        try:
            while self._queued < self._in_flight:
                self._pipe.submit()
                self._queued += 1
        except USBError as error:
            if error.errno == errno.ENOMEM:
                self.stop()
            raise

    def _reap(self, timeout_s: float) -> Completion | None:
        completion = self._pipe.reap(timeout_s)
        if completion is None:
            return None
        self._queued -= 1
        if completion.outcome is Outcome.GONE:
            raise device_gone()
        if completion.outcome is Outcome.FAILED:
            raise USBError("Input/Output Error", -1, errno.EIO)
        return completion

    def _recover(self, stalled: Completion) -> bytes:
        if stalled.data:
            self._ready.append(bytes(stalled.data))
        self._collect()
        self._pipe.clear_halt()
        self._fill()
        return b""

    def _collect(self) -> None:
        """Take every transfer back, keeping what it had brought."""
        if not self._queued:
            return
        self._pipe.cancel()
        deadline_s = self._clock() + _COLLECT_S
        while self._queued:
            completion = self._reap(max(0.0, deadline_s - self._clock()))
            if completion is None:
                raise timed_out()
            if completion.data:
                self._ready.append(bytes(completion.data))
