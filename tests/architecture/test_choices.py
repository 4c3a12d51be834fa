"""Every closed list of names is written down once; whoever offers its choices derives them.

A list, tuple, set, Literal or dictionary of three or more names of one closed list, anywhere but in the module that
defines it, is a second list: a new choice would be forgotten there. A string of such names counts too.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient

from acquisition.scenes.catalog import SCENES
from reconstruction.export.catalogue import FORMATS
from reconstruction.images import catalogue as image_catalogue
from reconstruction.run.configuration import CHOICES, FOLLOW, STAGES
from server.app import create_app
from server.cli.bench_runs import BENCHES
from server.cli.main import COMMANDS, cli
from server.schemas.job_types import JOB_TYPES, RIG_JOB_TYPES
from server.schemas.progress import Status
from server.settings import ServiceSettings

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("acquisition", "reconstruction", "rigs", "server")
MOST = 2  # names of one list that may stand together elsewhere


@dataclass(frozen=True)
class Closed:
    """A closed list: its names, and where they are written down (a file or a folder with a file a name)."""

    names: frozenset[str]
    homes: tuple[str, ...]


def closed(names: Iterable[str], *homes: str) -> Closed:
    return Closed(frozenset(names) - {"auto", "on", "off"}, homes)


LISTS = {
    "model": closed(CHOICES["model"], "reconstruction/methods/"),
    "image method": closed(CHOICES["images"], "reconstruction/images/"),
    "initialiser": closed(CHOICES["init"], "reconstruction/initialization/"),
    "supervision": closed(CHOICES["supervision"], "reconstruction/training/supervision/"),
    "export format": closed(FORMATS, "reconstruction/export/formats/"),
    "stage": closed(STAGES, "reconstruction/run/configuration.py"),
    "job type": closed({*JOB_TYPES, *RIG_JOB_TYPES}, "server/schemas/job_types.py"),
    "bench": closed(BENCHES, "server/cli/bench_runs.py"),
    "scene": closed(SCENES, "acquisition/scenes/"),
    "status": closed(get_args(Status), "server/schemas/progress.py"),
}
COMMAND_LINE_ONLY = {"dust3r", "random", "clean", "blurred", "ordinary"}
# (file or folder, list): why these names stand there beside the list itself. This table must only shrink.
ALLOWED = {
    ("reconstruction/bench/paper/", "supervision"): "the paper's protocol: the losses it compares",
    ("reconstruction/stability/models.py", "model"): "a model of each motion, made without a recording",
    ("reconstruction/stability/stiff.py", "scene"): "the ticks of each stiff scene",
    ("server/page/operator/words.js", "job type"): "the word a person reads for a type; another is shown by its name",
    ("server/schemas/jobs.py", "status"): "a stage's status, which may be waiting besides",
    ("server/work/processes.py", "job type"): "those whose exit code 1 is an answer",
    ("server/work/stages.py", "job type"): "the method of each type of work that is not a task",
}
SEQUENCES = (ast.List, ast.Tuple, ast.Set)


def written(tree: ast.AST) -> Iterator[tuple[int, set[str]]]:
    """Yield each group of strings that a module writes down together, with its line."""
    said = docstrings(tree)
    for node in ast.walk(tree):
        if isinstance(node, SEQUENCES):
            parts = node.elts
        elif isinstance(node, ast.Dict):
            parts = [key for key in node.keys if key is not None]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in said:
            yield node.lineno, set(re.findall(r"[\w-]+", node.value))
            continue
        else:
            continue
        yield node.lineno, {p.value for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)}


def docstrings(tree: ast.AST) -> set[ast.Constant]:
    holders = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    first = [node.body[0] for node in ast.walk(tree) if isinstance(node, holders) and node.body]
    return {e.value for e in first if isinstance(e, ast.Expr) and isinstance(e.value, ast.Constant)}


def written_in_page(text: str) -> Iterator[tuple[int, set[str]]]:
    """Yield each group of names in a script or page: of an array, an object's keys, or options."""
    for group in re.finditer(r"\[[^][{}]*\]|\{[^][{}]*\}|(<option.*</option>)+", text):
        of_object = group[0].startswith("{")
        names = re.findall(r"([\w-]+)['\"]?\s*:" if of_object else r"""["'>]([\w-]+)["'<]""", group[0])
        yield text[: group.start()].count("\n") + 1, set(names)


def second_lists() -> dict[tuple[str, str], str]:
    found = {}
    for path in (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.*"))):
        name = str(path.relative_to(ROOT))
        if path.suffix == ".py":
            groups = list(written(ast.parse(path.read_text())))
        elif path.suffix in (".js", ".html") and not {"vendor", "node_modules"} & set(path.parts):
            groups = list(written_in_page(path.read_text()))
        else:
            continue
        for kind, listed in LISTS.items():
            for line, names in groups if not name.startswith(listed.homes) else ():
                if len(names & listed.names) > max(MOST, len(names - listed.names)):
                    found[name, kind] = f"{name}:{line}: {kind}: {', '.join(sorted(names & listed.names))}"
    return found


def test_every_closed_list_is_written_down_once():
    found = second_lists()
    excused = {(one, key) for one in ALLOWED for key in found if key[0].startswith(one[0]) and key[1] == one[1]}
    known, used = {key for _, key in excused}, {one for one, _ in excused}
    assert [found[key] for key in found.keys() - known] == []
    assert ALLOWED.keys() - used == set(), "mended since: take it out of ALLOWED"


def test_a_second_list_would_be_found():
    tree = ast.parse("X = ['linear', 'cubic', 'stg']\nY = {'spz': 1, 'ply': 2}\nZ = 'l1, l2 or counts'")
    assert [names for _, names in written(tree)][:2] == [{"linear", "cubic", "stg"}, {"spz", "ply"}]
    assert {"l1", "l2", "or", "counts"} in [names for _, names in written(tree)]
    script = "const A = ['done', 'failed'];\nconst B = { stg: 1, 'dy-spikegs': 2 };\n<option>queued</option>"
    assert [names for _, names in written_in_page(script)] == [{"done", "failed"}, {"stg", "dy-spikegs"}, {"queued"}]


def help_of(*command: str) -> str:
    return " ".join(CliRunner().invoke(cli, [*command, "--help"], terminal_width=4000).output.split())


@pytest.mark.parametrize("name", CHOICES)
def test_reconstruct_offers_each_choice_of_a_run(name):
    assert re.search(rf"--{name} \S+ One of: {re.escape(', '.join(CHOICES[name]))}[.;]", help_of("reconstruct"))


def test_the_other_commands_offer_what_there_is():
    assert f"--stage [{'|'.join((FOLLOW, *STAGES))}]" in help_of("reconstruct")
    assert f"One of: {', '.join(FORMATS)}." in help_of("export")
    assert f"One of: {', '.join(image_catalogue.names())}." in help_of("images")
    assert set(SCENES) <= set(re.findall(r"\w+", help_of("simulate")))
    assert all(f" {name} " in help_of("bench") for name in BENCHES)
    assert all(f" {name} " in help_of() for name in COMMANDS)
    for name in ("model", "images", "init", "supervision"):
        assert f"--{name} [{'|'.join(offered(name))}]" in help_of("demo")


def test_the_first_help_loads_no_torch():
    code = "import sys; from server.cli.main import cli; cli(['-h'], standalone_mode=False); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert not {"torch", "fastapi"} & set(done.stdout.splitlines()[-1].split())


@pytest.fixture(scope="module")
def schemas(tmp_path_factory) -> dict[str, dict]:
    """The schemas of the OpenAPI document, by name."""
    app = create_app(ServiceSettings(data=tmp_path_factory.mktemp("data")))
    with TestClient(app, base_url="http://127.0.0.1") as http:
        return http.get("/openapi.json").json()["components"]["schemas"]


def offered(name: str) -> tuple[str, ...]:
    """The names that the service offers: all but those that need files of the user's, or are for benches."""
    return tuple(one for one in CHOICES[name] if one not in COMMAND_LINE_ONLY)


@pytest.mark.parametrize("name", CHOICES)
def test_the_document_offers_each_choice_of_a_run(name, schemas):
    assert tuple(schemas["ReconstructRequest"]["properties"][name]["enum"]) == offered(name)


def test_the_document_offers_what_there_is(schemas):
    methods = tuple(name for name in offered("images") if name != "auto")
    assert tuple(schemas["ImagesRequest"]["properties"]["method"]["enum"]) == methods
    assert set(schemas["ExportRequest"]["properties"]["format"]["enum"]) == set(FORMATS) - {"viewer"}
    assert tuple(schemas["RestartRequest"]["properties"]["stage"]["enum"]) == STAGES
    types = {schemas[model.__name__]["properties"]["type"]["const"] for model in JOB_TYPES.values()}
    assert types == set(JOB_TYPES)
