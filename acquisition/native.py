"""Loads the native library of a package, in the build that suits this processor."""

import ctypes
import functools
import importlib.metadata
from pathlib import Path

from acquisition.errors import AcquisitionError


def _builds(package: str) -> dict[str, Path]:
    try:
        folder = Path(str(importlib.metadata.distribution("spike4dgs").locate_file(package)))
    except importlib.metadata.PackageNotFoundError:
        return {}
    return {f.stem.rsplit("-", 1)[1]: f for f in folder.glob(f"lib{package}-*.so")}


@functools.cache
def load_library(package: str) -> ctypes.CDLL:
    """The shared library of `package`, built for the highest x86-64 level this processor has.

    Raises AcquisitionError where the package was imported without having been installed.
    """
    builds = _builds(package)
    if "plain" in builds:
        return ctypes.CDLL(str(builds["plain"]))
    if "v2" not in builds:
        raise AcquisitionError(f"found no native library in {package}, expected lib{package}-*.so; run `make install`")
    level = ctypes.CDLL(str(_builds("acquisition")["v2"])).native_x86_level()
    best = max((name for name in builds if int(name[1:]) <= level), default="v2")
    return ctypes.CDLL(str(builds[best]))
