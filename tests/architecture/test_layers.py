"""Dependencies point down, and importing costs what it must and no more."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("acquisition", "reconstruction", "rigs", "server")

IMPORT_ALL = """
import importlib, json, pkgutil, sys
DRAWS = "acquisition.scenes.realistic.rays"  # imported where something is drawn; needs an extra
before = set(sys.modules)
package = importlib.import_module(sys.argv[1])
for module in pkgutil.walk_packages(package.__path__, sys.argv[1] + "."):
    if not module.name.endswith("__main__") and not module.name.startswith(("server.cli", DRAWS)):
        importlib.import_module(module.name)
print(json.dumps(sorted({name.partition(".")[0] for name in set(sys.modules) - before})))
"""


def loaded_by(package: str) -> set[str]:
    """Top-level modules that importing every module of `package` brings in, in a fresh process."""
    done = subprocess.run([sys.executable, "-c", IMPORT_ALL, package], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout))


def test_import_linter_passes():
    done = subprocess.run([Path(sys.executable).with_name("lint-imports")], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("init", [p for name in PACKAGES for p in (ROOT / name).rglob("__init__.py")], ids=str)
def test_a_package_init_holds_a_docstring_only(init):
    statements = ast.parse(init.read_text()).body
    assert len(statements) == 1
    assert ast.get_docstring(ast.Module(statements, []))


def test_rigs_load_numpy_only():
    foreign = loaded_by("rigs") - set(sys.stdlib_module_names) - {"rigs"}
    assert {name for name in foreign if not name.startswith("_")} == {"numpy", "tomli_w"}


def test_acquisition_loads_no_torch_and_no_web_stack():
    loaded = loaded_by("acquisition")
    assert "numpy" in loaded
    assert not loaded & {"torch", "cv2", "pycolmap", "matplotlib", "fastapi", "dbos", "reconstruction", "server"}


def test_the_web_process_and_the_worker_load_no_torch():
    loaded = loaded_by("server")
    assert "fastapi" in loaded
    assert not loaded & {"torch", "cv2", "pycolmap", "matplotlib"}
