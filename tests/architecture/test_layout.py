"""Things lie where they are looked for, in pieces one can read at once."""

import ast
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("acquisition", "reconstruction", "rigs", "server")
FOLDERS = {*PACKAGES, "tests", "docker"}
VAGUE = {"utils", "util", "helpers", "helper", "common", "misc", "manager", "base"}
MODULES = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]
KERNELS = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.cpp"))]
FIXED_ELSEWHERE = {"ctrl_transfer"}  # the signature of a pyusb backend
LONGEST_CLASS = 150  # lines
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_the_top_level_is_the_one_agreed():
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout, so its files cannot be listed")
    folders = {line.split("/")[0] for line in listed.stdout.splitlines() if "/" in line}
    assert {folder for folder in folders if not folder.startswith(".")} <= FOLDERS


@pytest.mark.parametrize("folder", ["tests", "docker"])
def test_tests_and_docker_are_no_packages(folder):
    assert not list((ROOT / folder).rglob("__init__.py"))


@pytest.mark.parametrize("path", MODULES + KERNELS, ids=name_of)
def test_a_file_is_short_and_says_what_it_holds(path):
    text = path.read_text()
    assert len(text.splitlines()) <= 300
    assert not VAGUE & set(path.stem.split("_"))
    if path.suffix == ".py":
        assert ast.get_docstring(ast.parse(text))


def body_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    body = function.body[1:] if ast.get_docstring(function) else function.body
    return (function.end_lineno or 0) - body[0].lineno + 1 if body else 0


def positional(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    if function.decorator_list or function.name in FIXED_ELSEWHERE:  # click and FastAPI pass by name
        return 0
    return len([a for a in function.args.args if a.arg not in ("self", "cls")])


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_functions_are_short_and_take_few_positional_parameters(path):
    functions = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, FUNCTIONS)]
    assert [f"{f.name}: {body_lines(f)} lines" for f in functions if body_lines(f) > 40] == []
    assert [f"{f.name}: {positional(f)} positional" for f in functions if positional(f) > 6] == []


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_classes_are_short(path):
    classes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ClassDef)]
    lengths = {f"{name_of(path)}:{node.name}": (node.end_lineno or 0) - node.lineno + 1 for node in classes}
    assert {name: lines for name, lines in lengths.items() if lines > LONGEST_CLASS} == {}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_are_absolute(path):
    imports = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
    assert not [node.module for node in imports if node.level]
