"""Digests the code that a result depends on; a change of benches, reports or pages alone leaves the digest as it is."""

import functools
import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import acquisition
import reconstruction
import rigs
from acquisition.recording.manifest import MANIFEST_FILE
from reconstruction.bench.paper.method import Cell

SHOWN = ("bench", "stability", "report", "export", "uncertainty")  # folders of `reconstruction` that look at results
SUFFIXES = {".py", ".cpp", ".h", ".npz", ".toml", ".json"}
KEPT_DIGITS = 12


def cell_digest(cell: Cell, recording: Path) -> str:
    """Return a digest of the code, the cell's choices, and the manifest that holds the digests of the spikes."""
    return _of([code_digest(), asdict(cell), hashlib.sha256((recording / MANIFEST_FILE).read_bytes()).hexdigest()])


def asked_digest(cell: Cell) -> str:
    """Return a digest of the code and the cell's choices, which no recording is needed for."""
    return _of([code_digest(), asdict(cell)])


def this_code() -> str:
    """Return the first digits of the code's digest, which a row keeps."""
    return code_digest()[:KEPT_DIGITS]


@functools.cache
def code_digest() -> str:
    """Return the SHA-256 over the names and contents of the sources."""
    digest = hashlib.sha256()
    for name, path in sorted(_sources()):
        digest.update(f"{name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _of(about: list) -> str:
    return hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:KEPT_DIGITS]


def _sources() -> Iterator[tuple[str, Path]]:
    """Yield the name and path of every source, wherever the packages are installed."""
    packages = {m.__name__: Path(m.__path__[0]) for m in (rigs, acquisition, reconstruction)}
    folders = [("rigs", "."), ("acquisition", "spikes"), ("acquisition", "scenes")]
    inner = sorted(f.name for f in packages["reconstruction"].iterdir() if f.is_dir() and f.name not in SHOWN)
    for package, folder in (*folders, *(("reconstruction", name) for name in inner)):
        root = packages[package]
        for path in (root / folder).rglob("*"):
            if path.suffix in SUFFIXES:
                yield f"{package}/{path.relative_to(root)}", path
