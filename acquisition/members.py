"""Lists what the modules of a package define, so that a new file is all that a new choice takes."""

import importlib
import pkgutil
from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeVar

T = TypeVar("T")


def members(package: str, kind: type[T]) -> Mapping[str, T]:
    """Return every object of class `kind` that a module of `package` holds at its top level, by the object's `name`.

    Imports the modules of the package, in the order of their names; raises ValueError where two objects share a name.
    """
    found: dict[str, T] = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(importlib.import_module(package).__path__)):
        for value in vars(importlib.import_module(f"{package}.{module}")).values():
            if isinstance(value, kind):
                name = value.name  # type: ignore[attr-defined]
                if found.setdefault(name, value) is not value:
                    raise ValueError(f"found {name!r} twice in {package}, expected each name once")
    return MappingProxyType(found)
