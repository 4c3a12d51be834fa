"""Docstrings begin with a verb or a noun, never with a question, and nothing speaks in riddles.

ruff's rule D401 holds functions to the imperative mood; these are the patterns that it does not know.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("acquisition", "reconstruction", "rigs", "server")
FOLDERS = (*PACKAGES, "tests")
APART = {".venv", ".build", "node_modules", "vendor", "runs", "benchmarks"}
PAGES = sorted(p for p in ROOT.rglob("*.md") if not APART & set(p.parts))
OPENINGS = re.compile(r"(What|Who|Whom|Whose|That which|How|Whether|Where|When|Why)\b")
RIDDLES = re.compile(
    r"\bof what\b|\bthat stand or may\b|\bso manieth\b|\bwhat it has come to\b|\bhas what it\b|\bby how much that\b"
    r"|\bwhat is not wrong\b|\bwhat rides on\b",
    re.IGNORECASE,
)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def name_of(path):
    return str(path.relative_to(ROOT))


def files(package, *suffixes):
    return [p for p in sorted((ROOT / package).rglob("*")) if p.suffix in suffixes and not APART & set(p.parts)]


def riddles(path):
    lines = path.read_text().splitlines()
    return [f"{name_of(path)}:{i}: {line.strip()}" for i, line in enumerate(lines, 1) if RIDDLES.search(line)]


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_docstring_opens_with_no_question(folder):
    found = []
    for path in files(folder, ".py"):
        nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, DOCUMENTED)]
        texts = [text for node in nodes if (text := ast.get_docstring(node))]
        found += [f"{name_of(path)}: {text.splitlines()[0]}" for text in texts if OPENINGS.match(text)]
    assert found == []


@pytest.mark.parametrize("package", PACKAGES)
def test_code_does_not_speak_in_riddles(package):
    assert [line for path in files(package, ".py", ".cpp", ".h", ".js") for line in riddles(path)] == []


def test_documents_do_not_speak_in_riddles():
    assert [line for path in PAGES for line in riddles(path)] == []
