"""Nothing in the packages runs what it reads: no pickle, no eval, no shell. And the audit tells what it did not do."""

import ast
import importlib.util
import json
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("acquisition", "reconstruction", "rigs", "server")
MODULES = [path for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]

# (file, call): why it is safe there
EXCUSED: dict[tuple[str, str], str] = {}

BUILTINS = {"eval", "exec", "compile", "__import__", "breakpoint"}
MODULE_CALLS = {
    **{
        name: {"load", "loads", "Unpickler"}
        for name in ("pickle", "cPickle", "dill", "cloudpickle", "marshal", "joblib")
    },
    "shelve": {"open"},
    "yaml": {"load", "load_all", "unsafe_load", "full_load", "unsafe_load_all", "full_load_all"},
    "os": {"system", "popen", "spawnl", "spawnv"},
    "subprocess": {"getoutput", "getstatusoutput"},
    "tempfile": {"mktemp"},
}


def unsafe_calls(source: str) -> list[str]:
    """The calls that run what they are given, by the name they are called by."""
    tree = ast.parse(source)
    aliases = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            aliases |= {alias.asname or alias.name: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            aliases |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    return [name for node in ast.walk(tree) if isinstance(node, ast.Call) and (name := unsafe(node, aliases))]


def unsafe(call: ast.Call, aliases: dict[str, str]) -> str | None:
    written = ast.unparse(call.func)
    head, _, rest = written.partition(".")
    name = aliases.get(head, head) + (f".{rest}" if rest else "")
    module, _, function = name.rpartition(".")
    flags = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
    if name in BUILTINS or function in MODULE_CALLS.get(module, ()):
        return name
    if name == "torch.load" and flags.get("weights_only") != "True":
        return "torch.load without weights_only"
    if name in ("torch.jit.load", "torch.hub.load", "torch.package.PackageImporter"):
        return name
    if name in ("numpy.load", "np.load") and flags.get("allow_pickle", "False") != "False":
        return "numpy.load with allow_pickle"
    if flags.get("shell", "False") != "False" or function == "create_subprocess_shell":
        return f"{name} with a shell"
    return None


@pytest.mark.parametrize(
    "source",
    [
        *(
            "import pickle\npickle.load(f)",
            "from pickle import loads as read\nread(b)",
            "import pickle as p\np.Unpickler(f)",
        ),
        *(
            "import torch\ntorch.load(f)",
            "import torch\ntorch.load(f, weights_only=False)",
            "import yaml as y\ny.load(f)",
        ),
        *("import subprocess\nsubprocess.run(c, shell=True)", "eval(x)", "exec(x)", "import os\nos.system(x)"),
        *("import numpy as np\nnp.load(f, allow_pickle=True)", "import asyncio\nasyncio.create_subprocess_shell(c)"),
    ],
)
def test_an_unsafe_call_is_seen(source: str) -> None:
    assert len(unsafe_calls(source)) == 1


@pytest.mark.parametrize(
    "source",
    [
        *("import torch\ntorch.load(f, weights_only=True)", "import yaml\nyaml.safe_load(f)", "model.eval()"),
        *(
            "import re\nre.compile(x)",
            "import json\njson.loads(x)",
            "import numpy as np\nnp.load(f, allow_pickle=False)",
        ),
    ],
)
def test_a_safe_call_is_none(source: str) -> None:
    assert unsafe_calls(source) == []


def test_no_module_runs_what_it_reads() -> None:
    found = {(str(path.relative_to(ROOT)), name) for path in MODULES for name in unsafe_calls(path.read_text())}
    assert len(MODULES) > 200
    assert found - EXCUSED.keys() == set()
    assert EXCUSED.keys() - found == set()


# The audit of what is installed

spec = importlib.util.spec_from_file_location("audit", Path(__file__).with_name("audit.py"))
assert spec is not None
assert spec.loader is not None
audit = importlib.util.module_from_spec(spec)
spec.loader.exec_module(audit)

FLAW = {"id": "PYSEC-1", "aliases": ["CVE-1"], "fix_versions": ["2.0"]}
FLAWED = json.dumps(
    {"dependencies": [{"name": "a", "version": "1.0", "vulns": [FLAW]}, {"name": "b", "skip_reason": "x"}]}
)
UNKNOWN = json.dumps({"dependencies": [{"name": "a", "skip_reason": "Dependency not found on PyPI"}]})


def test_an_advisory_fails_the_check() -> None:
    code, lines = audit.judged(1, FLAWED, "", {})
    assert code == 1
    assert lines[0] == "audit: a 1.0: PYSEC-1, mended in 2.0"
    assert lines[-1] == "audit: 1 packages, 1 the service does not know, 1 advisories, 0 excused"


@pytest.mark.parametrize("name", ["PYSEC-1", "CVE-1"])
def test_an_excused_one_does_not(name: str) -> None:
    code, lines = audit.judged(1, FLAWED, "", {name: "we never call it", "CVE-9": "gone"})
    assert code == 0
    assert lines == [
        "audit: CVE-9 is excused in audit.toml and no longer found; take it out",
        "audit: 1 packages, 1 the service does not know, 1 advisories, 1 excused",
    ]


def test_what_was_not_audited_is_said() -> None:
    code, (line,) = audit.judged(0, UNKNOWN, "No known vulnerabilities found", {})
    assert code == 0
    assert "NOT DONE" in line
    code, (line,) = audit.judged(1, "", "Traceback\nrequests.exceptions.ConnectionError: no route", {})
    assert code == 0
    assert "NOT DONE" in line
    assert audit.judged(1, "", "ImportError: broken", {})[0] == 1


def test_every_excuse_has_a_reason() -> None:
    ignored = tomllib.loads(Path(__file__).with_name("audit.toml").read_text())["ignored"]
    assert all(isinstance(reason, str) and len(reason) > 20 for reason in ignored.values())
