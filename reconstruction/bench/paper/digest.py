"""Digests the code that a run depends on: what every run goes through, and of methods and networks those it uses.

A change of benches, reports, pages or trainings of networks alone leaves every digest as it is. So does one of
comments, docstrings or what a refusal says: of Python the syntax tree counts.
"""

import ast
import functools
import hashlib
import importlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

import acquisition
import reconstruction
import rigs
from acquisition.bench_document import device
from acquisition.recording.manifest import MANIFEST_FILE
from reconstruction.bench.paper.method import Cell, Method
from reconstruction.images import catalogue as images
from reconstruction.methods.catalogue import METHODS, OURS

SHOWN = ("bench", "stability", "report", "export", "uncertainty")  # folders of `reconstruction` that look at results
ASIDE = ("pipeline/report_page.py", "calibration/check.py")  # no score goes through them
TRAINING = ("networks/training/", "networks/train.py", "scenes/random/")  # makes networks, and is in no run
MSDI_WEIGHTS = "networks/msdi/weights/"
OF_ALL_METHODS = ("__init__", "catalogue", "definition")
NETWORK_INITIALISERS = ("msdi", "dust3r")
SUFFIXES = {".py", ".cpp", ".h", ".npz", ".toml", ".json"}
KEPT_DIGITS = 12
AUTO = "auto"
PLANNED = Method(AUTO)


def cell_digest(cell: Cell, recording: Path) -> str:
    """Return a digest of the code, the cell's choices, and the manifest that holds the digests of the spikes."""
    manifest = hashlib.sha256((recording / MANIFEST_FILE).read_bytes()).hexdigest()
    return _of([code_digest(cell.method), asdict(cell), manifest])


def asked_digest(cell: Cell) -> str:
    """Return a digest of the code and the cell's choices, which no recording is needed for."""
    return _of([code_digest(cell.method), asdict(cell)])


def this_code(method: Method = PLANNED) -> str:
    """Return the first digits of the `method`'s code digest, which a row keeps."""
    return code_digest(method)[:KEPT_DIGITS]


def code_and_machine(method: Method = PLANNED) -> dict[str, str | int]:
    """Return the `method`'s code and this machine, of which a result must be to be taken from a cache."""
    return device() | {"code": this_code(method)}


def networks_code() -> str:
    """Return the first digits of a digest of all that networks start from, are trained by and are scored by.

    Those are the networks, scenes, spikes, cameras and metrics. The weights of MSDI that ship are not among it: no
    training begins with them unasked.
    """
    parts = (reconstruction, "networks"), (reconstruction, "metrics"), (acquisition, "scenes"), (acquisition, "spikes")
    roots = [(Path(package.__path__[0]), folder) for package, folder in (*parts, (rigs, "."))]
    files = [(root, path) for root, folder in roots for path in (root / folder).rglob("*") if path.suffix in SUFFIXES]
    named = ((path.relative_to(root).as_posix(), path) for root, path in files)
    return _digest_over((name, path) for name, path in named if not name.startswith(MSDI_WEIGHTS))[:KEPT_DIGITS]


def code_digest(method: Method) -> str:
    """Return the SHA-256 over the names and contents of the sources that `method` runs."""
    model, source, init = (method.choices.get(choice, AUTO) for choice in ("model", "images", "init"))
    learned = source in images.names() and images.methods()[source].learned
    return _digest_of(model, learned or init in NETWORK_INITIALISERS)


@functools.cache
def _digest_of(model: str, networks: bool) -> str:
    return _digest_over(_sources(model, networks))


def _digest_over(sources: Iterable[tuple[str, Path]]) -> str:
    digest = hashlib.sha256()
    for name, path in sorted(sources):
        digest.update(f"{name}\0".encode() + hashlib.sha256(_meaning(path)).digest())
    return digest.hexdigest()


def _meaning(path: Path) -> bytes:
    """Return the bytes of a source, or of Python its syntax tree without docstrings and what is raised with."""
    if path.suffix != ".py":
        return path.read_bytes()
    return ast.dump(_Wordless().visit(ast.parse(path.read_bytes()))).encode()


class _Wordless(ast.NodeTransformer):
    """Takes from a syntax tree what only people read."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = node.body[1:] if ast.get_docstring(node, clean=False) is not None else node.body
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            node.exc = node.exc.func
        return super().generic_visit(node)


def _of(about: list) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:KEPT_DIGITS]


def _sources(model: str, networks: bool) -> Iterator[tuple[str, Path]]:
    """Yield the name and path of every source, wherever the packages are installed."""
    packages = {m.__name__: Path(m.__path__[0]) for m in (rigs, acquisition, reconstruction)}
    folders = [("rigs", "."), ("acquisition", "spikes"), ("acquisition", "scenes")]
    apart = (*SHOWN, "methods") if networks else (*SHOWN, "methods", "networks")
    inner = sorted(f.name for f in packages["reconstruction"].iterdir() if f.is_dir() and f.name not in apart)
    for package, folder in (*folders, *(("reconstruction", name) for name in inner)):
        root = packages[package]
        for path in (root / folder).rglob("*"):
            name = path.relative_to(root).as_posix()
            if path.suffix in SUFFIXES and not name.startswith((*TRAINING, *ASIDE)):
                yield f"{package}/{name}", path
    yield from _method_sources(model)


def _method_sources(model: str) -> Iterator[tuple[str, Path]]:
    """Yield the files that define `model`, or ours where the plan chooses, and those that all methods share."""
    folder = Path(importlib.import_module("reconstruction.methods").__path__[0])
    wanted = OURS if model == AUTO else [method for method in METHODS.values() if method.name == model]
    for path in folder.glob("*.py"):
        name = f"reconstruction.methods.{path.stem}"
        defined = [] if path.stem == "__init__" else vars(importlib.import_module(name)).values()
        if path.stem in OF_ALL_METHODS or any(value is method for value in defined for method in wanted):
            yield f"reconstruction/methods/{path.name}", path
