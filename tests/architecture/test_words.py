"""Docstrings begin with a verb or a noun, never with a question, and nothing speaks in riddles.

ruff's rule D401 holds functions to the imperative mood; these are the patterns that it does not know.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("acquisition", "reconstruction", "rigs", "server")
MODULES = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]
KERNELS = [p for name in PACKAGES for p in sorted((ROOT / name).rglob("*")) if p.suffix in (".cpp", ".h", ".js")]
PAGES = sorted(p for p in ROOT.rglob("*.md") if not {".venv", "node_modules", "runs", "benchmarks"} & set(p.parts))
OPENINGS = re.compile(r"(What|Who|Whom|Whose|That which|How|Whether|Where|When|Why)\b")
RIDDLES = re.compile(
    r"\bof what\b|\bthat stand or may\b|\bso manieth\b|\bwhat it has come to\b|\bhas what it\b|\bby how much that\b"
    r"|\bwhat is not wrong\b|\bwhat rides on\b",
    re.IGNORECASE,
)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def name_of(path):
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_a_docstring_opens_with_no_question(path):
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, DOCUMENTED)]
    texts = [text for node in nodes if (text := ast.get_docstring(node))]
    assert [text.splitlines()[0] for text in texts if OPENINGS.match(text)] == []


@pytest.mark.parametrize("path", MODULES + KERNELS + PAGES, ids=name_of)
def test_nothing_speaks_in_riddles(path):
    lines = path.read_text().splitlines()
    assert [f"{i}: {line.strip()}" for i, line in enumerate(lines, 1) if RIDDLES.search(line)] == []
