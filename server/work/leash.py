"""Runs a command that cannot outlive its parent: `python -m server.work.leash SIGNAL PARENT_PID COMMAND...`.

The kernel sends SIGNAL when the parent dies, even by kill -9. The setting survives the exec below, and asking for it
here rather than between fork and exec keeps the parent free of code that is unsafe beside its threads.
"""

import ctypes
import os
import signal
import subprocess
import sys

_PR_SET_PDEATHSIG = 1


def leashed(command: list[str], signal_name: str) -> list[str]:
    """Return `command` wrapped so that it dies with this process, which must be the one to start it."""
    return [sys.executable, "-P", "-m", "server.work.leash", signal_name, str(os.getpid()), *command]


def stop_process(process: subprocess.Popen[bytes], patience_s: float) -> None:
    """End a process with SIGTERM, and after `patience_s` with SIGKILL; return when it is gone."""
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def named_end(code: int) -> str:
    """Return how a process ended: the signal of a negative exit code, or the code."""
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def die_with_parent(number: signal.Signals) -> None:
    """Let the kernel send this process a signal when its parent dies."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number, 0, 0, 0)


def main() -> None:
    """Ask for the signal, check that the parent still lives, and become the command."""
    signal_name, parent, *command = sys.argv[1:]
    die_with_parent(signal.Signals[signal_name])
    if os.getppid() != int(parent):  # it died before the kernel was asked
        sys.exit(1)
    os.execvp(command[0], command)


if __name__ == "__main__":
    main()
