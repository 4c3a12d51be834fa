"""Loads the native library of a package, in the build that suits this processor."""

import ctypes
import functools
import importlib.metadata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.errors import AcquisitionError

_chosen: ContextVar[str | None] = ContextVar("code_path", default=None)


def _builds(package: str) -> dict[str, Path]:
    try:
        folder = Path(str(importlib.metadata.distribution("spike4dgs").locate_file(package)))
    except importlib.metadata.PackageNotFoundError:
        return {}
    return {f.stem.rsplit("-", 1)[1]: f for f in folder.glob(f"lib{package}-*.so")}


@functools.cache
def code_paths() -> tuple[str, ...]:
    """List the builds that this processor runs, the best last; none where the package is not installed.

    They are `v2` to `v4` on x86-64, `plain` elsewhere.
    """
    builds = _builds("acquisition")
    if "plain" in builds or "v2" not in builds:
        return ("plain",) if "plain" in builds else ()
    level = ctypes.CDLL(str(builds["v2"])).native_x86_level()
    return tuple(sorted(name for name in builds if int(name[1:]) <= level)) or ("v2",)


@contextmanager
def code_path(name: str) -> Iterator[None]:
    """Use the kernels of the build `name`, one of `code_paths`, in this thread inside the block."""
    if name not in code_paths():
        raise AcquisitionError(f"found the code path {name}", f"one of {', '.join(code_paths())}")
    token = _chosen.set(name)
    try:
        yield
    finally:
        _chosen.reset(token)


def load_library(package: str) -> ctypes.CDLL:
    """Load the shared library of `package` in the build that `code_path` chose, or the best this processor runs.

    Raises AcquisitionError where the package was imported without having been installed.
    """
    if not code_paths():
        raise AcquisitionError(f"found no native library in {package}", f"lib{package}-*.so", "run `make install`")
    return _loaded(package, _chosen.get() or code_paths()[-1])


class Address:
    """Argument type of a kernel that takes the first element of a C-contiguous array or tensor, or None."""

    @classmethod
    def from_param(cls, value: Any) -> ctypes.c_void_p:
        """Return the address; raises TypeError (a bug of the caller) for strided memory or another type."""
        if value is None:
            return ctypes.c_void_p(None)
        if isinstance(value, np.ndarray):
            contiguous, address = value.flags.c_contiguous, value.ctypes.data
        elif hasattr(value, "data_ptr"):
            contiguous, address = value.is_contiguous(), value.data_ptr()
        else:
            raise TypeError(f"found {type(value).__name__}, expected an array, a tensor or None")
        if not contiguous:
            raise TypeError(f"found strided memory of shape {tuple(value.shape)}, expected it C-contiguous")
        return ctypes.c_void_p(address)


class Kernel:
    """One function of a package's native library, with declared argument types; call it like a function.

    `argument_types` are `Address` for arrays and tensors, ctypes' types for numbers and structures.
    """

    def __init__(self, package: str, name: str, *argument_types: Any, returns: Any = None):
        self.package, self.name = package, name
        self.argument_types, self.returns = argument_types, returns
        self._functions: dict[int, Any] = {}  # one a build of the library

    def __call__(self, *arguments: Any) -> Any:
        """Run the kernel of this thread's build."""
        return self.bound()(*arguments)

    def bound(self) -> Callable[..., Any]:
        """Return the function of this thread's build, for a caller who must stay with that build."""
        library = load_library(self.package)
        function = self._functions.get(id(library))
        if function is None:
            function = library[self.name]  # an object of its own, so that no other declaration changes it
            function.argtypes, function.restype = self.argument_types, self.returns
            self._functions[id(library)] = function
        return function


@functools.cache
def _loaded(package: str, name: str) -> ctypes.CDLL:
    return ctypes.CDLL(str(_builds(package)[name]))
