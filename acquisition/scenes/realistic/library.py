"""Finds the renderer, the physics engine and the files that come with them, or says what to install."""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import importlib.util
import os
from pathlib import Path
from types import ModuleType

from acquisition.errors import AcquisitionError

EXTRA = "pip install 'spike4dgs[realistic]'"
VARIANT = "llvm_ad_mono"  # light alone, no colours


class MissingRendererError(AcquisitionError):
    """A scene that needs packages that are not installed."""

    exit_code = 2


def needed(name: str) -> ModuleType:
    """Import the module `name` of the extra; raises MissingRendererError where it is not there."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingRendererError(f"found no {name}", "the packages of realistic scenes", EXTRA) from error


@functools.cache
def mitsuba() -> ModuleType:
    """Import Mitsuba with its vectorised variant, which needs an LLVM of 16 or later beside it."""
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(_llvm()))
    renderer = needed("mitsuba")
    if renderer.variant() != VARIANT:
        renderer.set_variant(VARIANT)
    return renderer


def drjit() -> ModuleType:
    """Import the compiler of arrays that Mitsuba is written in."""
    mitsuba()
    return needed("drjit")


def folder_of(name: str) -> Path:
    """Return the folder of the package `name`, without importing what it holds."""
    spec = importlib.util.find_spec(name)
    if spec is None or spec.origin is None:
        raise MissingRendererError(f"found no {name}", "the packages of realistic scenes", EXTRA)
    return Path(spec.origin).parent


def versions() -> dict[str, str]:
    """Return the versions of all that a picture depends on; raises MissingRendererError where one is missing."""
    packages = ("mitsuba", "drjit", "pybullet", "scikit-image")
    try:
        return {package: importlib.metadata.version(package) for package in packages}
    except importlib.metadata.PackageNotFoundError as error:
        raise MissingRendererError(f"found no {error.name}", "the packages of realistic scenes", EXTRA) from error


def _llvm() -> Path:
    try:
        files = importlib.metadata.files("karellen-llvm-core") or []
    except importlib.metadata.PackageNotFoundError as error:
        raise MissingRendererError("found no karellen-llvm-core", "an LLVM for Mitsuba", EXTRA) from error
    found = [Path(str(file.locate())) for file in files if file.name.startswith("libLLVM.so")]
    if not found:
        raise MissingRendererError("found no libLLVM.so in karellen-llvm-core", "one", EXTRA)
    return found[0].resolve()
