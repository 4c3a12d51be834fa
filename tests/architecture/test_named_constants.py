"""A constant that a docstring or a comment names is there."""

import ast
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("acquisition", "reconstruction", "rigs", "server")
MODULES = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]
CONSTANT = re.compile(r"(?<![$\w.])_?[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)+(?![\w=])")
FOREIGN = {  # of formats, formulas, the environment and the operating system
    *("SQUARE_MM", "MARKER_MM", "TAG_MM", "GAP_MM", "COLOR_0", "C_0"),
    *("LOCAL_RANK", "WORLD_SIZE", "TCP_NODELAY", "PARENT_PID"),
}
ENVIRONMENT = ("SPIKE4DGS_", "OTEL_")


def names_of(tree):
    """Every name a module binds or uses."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.alias):
            yield node.asname or node.name.split(".")[-1]


def told_by(path, tree):
    """The prose of a module: docstrings and comments."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    yield from (ast.get_docstring(node) or "" for node in ast.walk(tree) if isinstance(node, kinds))
    with path.open("rb") as source:
        yield from (token.string for token in tokenize.tokenize(source.readline) if token.type == tokenize.COMMENT)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_prose_names_constants_that_are_there(path):
    tree = ast.parse(path.read_text())
    named = {name for text in told_by(path, tree) for name in CONSTANT.findall(text)}
    assert {n for n in named - set(names_of(tree)) - FOREIGN if not n.startswith(ENVIRONMENT)} == set()


def test_a_constant_that_is_not_there_is_noticed(tmp_path):
    path = tmp_path / "bench.py"
    path.write_text('"""A plan may cost LEAST_DB, or COST_DB."""\nCOST_DB = 0.1  # at most\n')
    with pytest.raises(AssertionError, match="LEAST_DB"):
        test_prose_names_constants_that_are_there(path)
