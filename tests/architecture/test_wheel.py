"""The wheel, in a clean environment with the base dependencies only: what a capture host gets."""

import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.slow

IMPORT_ALL = """
import importlib, pkgutil, sys
for name in ("rigs", "acquisition"):
    for module in pkgutil.walk_packages(importlib.import_module(name).__path__, name + "."):
        drawn = module.name == "acquisition.scenes.realistic.rays"  # for who has the extra `realistic`
        if not drawn and "-" not in module.name:  # libacquisition-v2.so is no Python module
            importlib.import_module(module.name)
from acquisition.native import load_library
from rigs.toml import catalog_names
load_library("acquisition"), load_library("reconstruction")
print(*catalog_names())
"""


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run([str(c) for c in command], cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = f"build-dir={folder / 'build'}"  # not the one an editable install is built in
    run(sys.executable, "-m", "pip", "wheel", ROOT, "--no-deps", "--quiet", "-C", build, "-w", folder, cwd=folder)
    return next(folder.glob("spike4dgs-*.whl"))


@pytest.fixture(scope="module")
def host(wheel, tmp_path_factory) -> Path:
    """The `bin` folder of an environment that holds the wheel and its base dependencies."""
    folder = tmp_path_factory.mktemp("host")
    venv.create(folder, with_pip=True, symlinks=True)
    run(folder / "bin/python", "-m", "pip", "install", "--quiet", wheel, cwd=folder)
    return folder / "bin"


def test_wheel_holds_the_libraries_the_catalog_and_no_sources(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    for package in ("acquisition", "reconstruction"):
        assert [n for n in names if n.startswith(f"{package}/lib{package}-") and n.endswith(".so")]
    assert {"rigs/catalog/lab3x3.toml", "rigs/catalog/ci3x3.toml"} <= set(names)
    assert {f"reconstruction/networks/weights/{n}.npz" for n in ("small", "blindspot")} <= set(names)
    for source in ROOT.glob("server/page/*.*"):
        assert f"server/page/{source.name}" in names
    assert not [n for n in names if n.endswith((".cpp", ".h")) or n.startswith(("tests/", "docker/"))]


def test_capture_host_has_no_torch_and_imports_all_it_needs(host, tmp_path):
    installed = run(host / "python", "-m", "pip", "list", "--format=freeze", cwd=tmp_path).lower()
    assert "spike4dgs==" in installed
    assert not [name for name in ("torch==", "fastapi==", "pycolmap==", "opencv") if name in installed]
    assert run(host / "python", "-c", IMPORT_ALL, cwd=tmp_path).split() == ["ci3x3", "lab3x3"]


def test_capture_host_simulates_and_verifies(host, tmp_path):
    assert "simulate" in run(host / "spike4dgs", "--help", cwd=tmp_path)
    simulate = ("simulate", "--scene", "fan_and_ball", "--ticks", "40", "--size", "40x26", "--seed", "1")
    run(host / "spike4dgs", *simulate, "--out", tmp_path / "rec", cwd=tmp_path)
    run(host / "spike4dgs", "verify", tmp_path / "rec", cwd=tmp_path)


def test_capture_host_says_what_reconstruction_lacks(host, tmp_path):
    done = subprocess.run([host / "spike4dgs", "reconstruct", "--help"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert "spike4dgs[reconstruction,server]" in done.stderr
    assert "Traceback" not in done.stderr
