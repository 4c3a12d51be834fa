"""Takes numbers and words out of a parsed file, or raises an error that names the file, the camera and the field."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from rigs.errors import RigError


class Fields:
    """One table of a TOML or JSON file; `where` says which, as in `lab.toml: cam01`.

    Every look-up raises RigError where the field is missing, of another type, or not finite.
    """

    def __init__(self, table: object, where: str):
        if not isinstance(table, dict):
            raise RigError(f"found {_short(table)}", "a table of fields", where=where)
        self.table = table
        self.where = where

    def refuse_others(self, known: Collection[str]) -> None:
        """Raise RigError for a field that is not among `known`: a misspelt name must not be passed over."""
        for key in self.table:
            if key not in known:
                raise RigError(f"found the unknown field {key!r}", ", ".join(known), where=self.where)

    def number(self, key: str, default: float | None = None) -> float:
        """Return the finite number under `key`."""
        found = self._get(key, default)
        try:
            value = float(found) if isinstance(found, (int, float)) and not isinstance(found, bool) else math.nan
        except OverflowError:
            value = math.inf
        if not math.isfinite(value):
            raise self._wrong(key, "a finite number")
        return value

    def whole(self, key: str, default: int | None = None) -> int:
        """Return the whole number under `key`, at least 1."""
        value = self.number(key, default)
        if value != int(value) or value < 1:
            raise self._wrong(key, "a whole number of at least 1")
        return int(value)

    def word(self, key: str, default: str | None = None) -> str:
        """Return the string under `key`."""
        found = self._get(key, default)
        if not isinstance(found, str):
            raise self._wrong(key, "a string")
        return found

    def numbers(self, key: str, shape: tuple[int, ...], default: object = None) -> NDArray[np.float64]:
        """Return the finite numbers under `key`, which are nested lists of this shape."""
        try:
            array = np.asarray(self._get(key, default))
        except ValueError:  # rows of different lengths
            array = np.empty(0)
        if array.dtype.kind not in "if" or array.shape != shape:
            raise self._wrong(key, f"{'x'.join(map(str, shape))} numbers")
        if not np.isfinite(array).all():
            raise self._wrong(key, "finite numbers")
        return array.astype(np.float64)

    def table_at(self, key: str) -> Fields:
        """Return the table under `key`."""
        return Fields(self._get(key, None), f"{self.where}: {key}")

    def list_at(self, key: str) -> list[object]:
        """Return the list under `key`, which has at least one entry."""
        found = self._get(key, None)
        if not isinstance(found, list) or not found:
            raise self._wrong(key, "a list with at least one entry")
        return found

    def _get(self, key: str, default: object) -> object:
        found = self.table.get(key, default)
        if found is None:
            raise RigError(f"found no field {key}", do="add it", where=self.where)
        return found

    def _wrong(self, key: str, expected: str) -> RigError:
        return RigError(f"found {key} = {_short(self.table.get(key))}", expected, where=self.where)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
