"""A stream pipe over libusb's asynchronous transfers, for hardware and for emulated devices on a real kernel."""

# usb1 binds its names when it is imported.
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportCallIssue=false
import contextlib
import ctypes
import errno
import functools
import time
from collections import deque
from collections.abc import Iterator

import libusb_package
import usb1
from usb.core import USBError

from acquisition.devices.profile import Profile
from acquisition.devices.stream import Completion, Outcome, device_gone

_ERRNO = {
    -1: errno.EIO,
    -3: errno.EACCES,
    -4: errno.ENODEV,
    -5: errno.ENOENT,
    -6: errno.EBUSY,
    -7: errno.ETIMEDOUT,
    -8: errno.EOVERFLOW,
    -9: errno.EPIPE,
    -11: errno.ENOMEM,
}
_OUTCOMES = {
    usb1.TRANSFER_COMPLETED: Outcome.DONE,
    usb1.TRANSFER_CANCELLED: Outcome.CANCELLED,
    usb1.TRANSFER_STALL: Outcome.STALLED,
    usb1.TRANSFER_NO_DEVICE: Outcome.GONE,
}


class LibusbPipe:
    """The stream of the device at `address` of `bus`, on a handle that holds its interface.

    Each has a libusb context of its own, so that no camera handles another's events. Raises USBError.
    """

    def __init__(self, bus: int, address: int, profile: Profile):
        self._profile = profile
        self._closed = False
        self._free: list[usb1.USBTransfer] = []
        self._flying: deque[usb1.USBTransfer] = deque()
        with _as_pyusb():
            usb1.loadLibrary(_library())
            self._context = usb1.USBContext().open()
        try:
            with _as_pyusb():
                self._handle = self._open(bus, address)
                self._handle.claimInterface(profile.interface)
        except USBError:
            self._context.close()
            raise

    def submit(self) -> None:
        """Queue one more transfer."""
        self._require_open()
        with _as_pyusb():
            transfer = self._free.pop() if self._free else self._handle.getTransfer()
            if not transfer.getBuffer():
                transfer.setBulk(self._profile.stream_endpoint, self._profile.transfer_bytes)
            try:
                transfer.submit()
            except usb1.USBError:
                self._free.append(transfer)
                raise
        self._flying.append(transfer)

    def reap(self, timeout_s: float) -> Completion | None:
        """Return the oldest transfer, or None when it does not end within `timeout_s`."""
        if not self._flying:
            return None
        transfer = self._flying[0]
        deadline_s = time.monotonic() + timeout_s
        with _as_pyusb():
            while transfer.isSubmitted():
                left_s = deadline_s - time.monotonic()
                self._context.handleEventsTimeout(max(0.0, left_s))
                if left_s <= 0 and transfer.isSubmitted():
                    return None
        self._free.append(self._flying.popleft())
        outcome = _OUTCOMES.get(transfer.getStatus(), Outcome.FAILED)
        return Completion(outcome, memoryview(transfer.getBuffer())[: transfer.getActualLength()])

    def cancel(self) -> None:
        """Ask for all transfers to end now."""
        for transfer in self._flying:
            with contextlib.suppress(usb1.USBErrorNotFound, usb1.USBErrorNoDevice):  # ended already
                if transfer.isSubmitted():
                    transfer.cancel()

    def clear_halt(self) -> None:
        """End a stall."""
        with _as_pyusb():
            self._handle.clearHalt(self._profile.stream_endpoint)

    def write(self, endpoint: int, data: bytes, timeout_s: float) -> None:
        """Send all of `data` to another endpoint of the interface."""
        self._require_open()
        with _as_pyusb():
            self._handle.bulkWrite(endpoint, data, round(timeout_s * 1e3))

    def read(self, endpoint: int, size: int, timeout_s: float) -> bytes:
        """Return what comes from another endpoint, up to a short packet or `size` bytes."""
        self._require_open()
        with _as_pyusb():
            return bytes(self._handle.bulkRead(endpoint, size, round(timeout_s * 1e3)))

    def close(self) -> None:
        """Give the device back."""
        self._closed = True
        with contextlib.suppress(usb1.USBError):
            self._handle.close()
        self._context.close()

    def _require_open(self) -> None:
        if self._closed:  # libusb would not survive it
            raise device_gone()

    def _open(self, bus: int, address: int) -> usb1.USBDeviceHandle:
        for device in self._context.getDeviceIterator(skip_on_error=True):
            if (device.getBusNumber(), device.getDeviceAddress()) == (bus, address):
                return device.open()
        raise device_gone()


@functools.cache
def _library() -> ctypes.CDLL | None:
    """Return the very library that pyusb uses; None lets usb1 look for one."""
    path = libusb_package.get_library_path()
    return None if path is None else ctypes.CDLL(str(path))


@contextlib.contextmanager
def _as_pyusb() -> Iterator[None]:
    try:
        yield
    except usb1.USBError as error:
        code = int(error.value)
        raise USBError(str(error), code, _ERRNO.get(code, errno.EIO)) from error
