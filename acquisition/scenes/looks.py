"""Logs looks at evaluation scenes: which bench saw which scene, at which revision, on which day, and why.

What has been looked at can no longer be called unseen, and a change that followed a look is tuned on it.
"""

import json
from collections.abc import Iterable
from pathlib import Path

from acquisition.bench_document import SPAN
from acquisition.durable import write_durably
from acquisition.scenes.catalog import (
    EVALUATION,
    LONG_EVALUATION,
    REALISTIC_EVALUATION,
    REALISTIC_LONG_EVALUATION,
    STRESS,
)

LOOKS = "looks.jsonl"  # the log, a look a line, among the documents of the benches
EVALUATED = frozenset((*EVALUATION, *STRESS, *LONG_EVALUATION, *REALISTIC_EVALUATION, *REALISTIC_LONG_EVALUATION))
NO_REASON = "none was given"


def looks_of(document: dict, day: str, reason: str = NO_REASON) -> list[dict]:
    """Return a look for each evaluation scene and revision among the rows of a bench's document.

    `day` is a date as 2026-11-26. Rows without a revision of their own are of the document's. Those of spans are
    parts of runs, and do not count.
    """
    runs: dict[tuple[str, str], int] = {}
    for row in document["rows"]:
        if row.get("scene") in EVALUATED and row.get("part") != SPAN:
            key = str(row.get("revision", document["revision"])), row["scene"]
            runs[key] = runs.get(key, 0) + 1
    about = {"bench": document["bench"], "day": day, "reason": reason}
    return [about | {"revision": revision, "scene": scene, "runs": count} for (revision, scene), count in runs.items()]


def read_looks(file: Path) -> list[dict]:
    """Return the looks of a log, the first ones first; none where there is no log."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def add_looks(file: Path, found: Iterable[dict]) -> None:
    """Add looks to the log `file`; of one that is there already, the first day and its reason stay."""
    known = {_key(look): look for look in read_looks(file)}
    for look in found:
        before = known.setdefault(_key(look), look)
        before["runs"] = max(before["runs"], look["runs"])
    if known:
        write_durably(file, "".join(f"{json.dumps(look)}\n" for look in known.values()).encode())


def _key(look: dict) -> tuple[str, str, str]:
    return look["bench"], look["revision"], look["scene"]
