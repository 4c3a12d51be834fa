"""Control of a running capture from the terminal: signals end it, a line on standard input saves it."""

import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Iterator

from acquisition.session.session import Control

_POLL_S = 0.1  # between looks at standard input


@contextlib.contextmanager
def operator_control(*, saves: bool) -> Iterator[Control]:
    """Yield a control whose `stop` the first SIGINT or SIGTERM sets; the second one interrupts as usual.

    SIGUSR1 sets `cut_off`: the worker that started this process is gone, or is told to end. The kernel may send it for
    each thread of a worker that dies, so it may come again.
    If it `saves`, the first line on standard input sets `save`; the end of standard input does not.
    """
    control = Control()
    left = threading.Event()
    orders = {signal.SIGINT: control.stop, signal.SIGTERM: control.stop, signal.SIGUSR1: control.cut_off}
    before = {number: signal.getsignal(number) for number in orders}

    def stop(number: int, frame: object) -> None:
        orders[signal.Signals(number)].set()
        if number != signal.SIGUSR1:
            signal.signal(number, before[signal.Signals(number)])

    for number in before:
        signal.signal(number, stop)
    if saves:
        threading.Thread(target=_wait_for_line, args=(control, left), name="standard input", daemon=True).start()
    try:
        yield control
    finally:
        left.set()
        for number, handler in before.items():
            signal.signal(number, handler)


def _wait_for_line(control: Control, left: threading.Event) -> None:
    """Read standard input by its file descriptor.

    A thread that waits in sys.stdin holds its lock, which the interpreter then cannot take when it ends.
    """
    handle = sys.__stdin__.fileno() if sys.__stdin__ else -1
    while not left.is_set() and handle >= 0:
        if select.select([handle], [], [], _POLL_S)[0]:
            data = os.read(handle, 4096)
            if b"\n" in data:
                control.save.set()
            if not data or control.save.is_set():
                return
