"""Identifies the evaluation scenes by a SHA-256 of each, committed beside this file."""

import hashlib
import json
from pathlib import Path

COMMITTED = Path(__file__).with_name("evaluation.json")
COMMITTED_LONG = Path(__file__).with_name("long_evaluation.json")
COMMITTED_REALISTIC = Path(__file__).with_name("realistic") / "evaluation.json"


def scenes_digest(digests: dict[str, str]) -> str:
    """Return the SHA-256 of the digests of single scenes, in the order of their names."""
    return hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()


def committed_digests(path: Path = COMMITTED) -> dict[str, str]:
    """Read the digests of the scenes as they were settled, by `name-seed`."""
    return json.loads(path.read_text())
