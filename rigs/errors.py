"""Errors that reach a person, in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self


class Spike4dgsError(Exception):
    """Root of every error this project raises on purpose.

    `found` says what is wrong, `expected` what would have been right, `do` what a person may do about it, and `where`
    names the file, camera or option concerned. An error prints as `where: found, expected ...; do`. `exit_code` is
    what the command line returns. `bad_input`: the fault is what was asked for or recorded, so the same fails again.
    """

    exit_code = 1
    bad_input = False

    def __init__(self, found: str, expected: str = "", do: str = "", *, where: object = ""):
        super().__init__(found, expected, do)
        self.found, self.expected, self.do, self.where = found, expected, do, str(where)

    def __str__(self) -> str:
        """Return all fields in one line."""
        place = f"{self.where}: " if self.where else ""
        return f"{place}{self.found}{self.expected and ', expected '}{self.expected}{self.do and '; '}{self.do}"

    @classmethod
    def at(cls, where: object, error: Exception) -> Self:
        """Return an error of this class that says what `error` says, and `where` it happened."""
        if not isinstance(error, Spike4dgsError):
            return cls(str(error), where=where)
        return cls(error.found, error.expected, error.do, where=f"{where}: {error.where}" if error.where else where)

    @classmethod
    @contextmanager
    def located(cls, where: object) -> Iterator[None]:
        """Put `where` in front of the place of every error of this class raised inside."""
        try:
            yield
        except cls as error:
            raise error.at(where, error) from error

    @classmethod
    @contextmanager
    def reading(cls, path: Path, do: str = "") -> Iterator[None]:
        """Raise an error of this class that names `path` where the disk does not give what is read inside."""
        try:
            yield
        except OSError as error:
            raise cls(f"cannot be read ({error.strerror})", do=do, where=path) from error


class RigError(Spike4dgsError):
    """A rig, camera or pose that cannot be used."""

    exit_code = 2
    bad_input = True
