"""Kills parts of a running service at random while clients use it, and counts what is lost, repeated or left behind.

`make faults` runs rounds on both databases, side by side; `--database` chooses one of them. Each round that ends is
written at once, and rounds that OUT has of this code are not run again. What a round with a fault left is kept.
"""

from __future__ import annotations

import json
import random
import shutil
import tempfile
import threading
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import click
import httpx
from maintenance.campaign import Campaign, Plan
from maintenance.capture_clients import rig_variables
from maintenance.capture_verdict import FAULTS
from maintenance.deployment import Deployment

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from acquisition.revision import code_revision
from rigs.errors import Spike4dgsError

DATABASES = ("sqlite", "postgres")
ZEROS = (
    *("lost", "undone", "repeated", "reopened", "torn", "orphans", "locked", "ended_alone", "answers.500", "broken"),
    *(f"captures.{fault}" for fault in FAULTS),
)
_DEAD_S, _STEP_S = 3.0, 0.03


def run_campaign(folder: Path, plan: Plan, database: str, seed: int, limit_s: float = 1500.0) -> dict[str, Any]:
    """Return the counts of one campaign over an empty `folder`; `at_fault` has what is not as it should be.

    A campaign that does not come to its end is `broken`, and says why.
    """
    began = time.monotonic()
    rows, counts, notes = [], {"broken": 0.0}, []
    deployment = Deployment(
        folder / "data",
        postgresql=database == "postgres",
        dead_s=_DEAD_S,
        step_s=_STEP_S,
        environment=rig_variables(folder),
    )
    campaign = Campaign(deployment, plan, random.Random(seed))
    try:
        campaign.run(limit_s)
        rows, counts = campaign.judge()
    except (Spike4dgsError, httpx.HTTPError, OSError, LookupError, ValueError) as error:
        counts["broken"] = 1.0
        notes.append(f"{type(error).__name__}: {error}")
    finally:
        deployment.close()
    counts["seconds"] = time.monotonic() - began
    at_fault = [row for row in rows if is_at_fault(row)]
    return {
        "database": database,
        "seed": seed,
        "counts": {name: round(count, 2) for name, count in counts.items()},
        "at_fault": [*at_fault, *campaign.ended_alone, *notes],
    }


def is_at_fault(row: Mapping[str, Any]) -> bool:
    """Return whether a job or a capture is not as it should be."""
    if "faults" in row:
        return bool(row["faults"])
    return row["status"] != "done" or any(row[name] for name in ("missing", "repeated", "reopened", "torn"))


def faults_of(counts: Mapping[str, float]) -> dict[str, float]:
    """Return the counts that should be zero and are not."""
    return {name: counts[name] for name in ZEROS if counts.get(name)}


class Rounds:
    """The rounds of all databases in the document `out`, which is written after each."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._writing = threading.Lock()
        self._revision = code_revision()
        found = json.loads(out.read_text()) if out.exists() else {"rows": []}
        self.rows = [row for row in found["rows"] if _code(row.get("revision")) == _code(self._revision)]

    def missing(self, database: str, seeds: range) -> list[int]:
        """Return the seeds of the rounds that were not run yet."""
        done = [row["seed"] for row in self.rows if row["database"] == database]
        return [seed for seed in seeds if seed not in done]

    def run(self, database: str, seed: int, plan: Plan) -> None:
        """Run a round and add it; where it has a fault, say where its data and logs are."""
        folder = Path(tempfile.mkdtemp(prefix=f"spike4dgs-faults-{database}-{seed}-"))
        row = run_campaign(folder, plan, database, seed) | {"revision": self._revision}
        faults = faults_of(row["counts"])
        click.echo(f"{database} round {seed}: {row['counts'].get('kills', 0):g} kills, {faults or 'no fault'}")
        if faults:
            row["kept"] = str(folder)
            click.echo(f"{database} round {seed}: its data and logs are kept in {folder}: {row['at_fault']}", err=True)
        else:
            shutil.rmtree(folder)
        with self._writing:
            self.rows.append(row)
            write_json(self._out, self.document().to_json() | {"revision": self.rows[0]["revision"]})

    def document(self) -> BenchDocument:
        """Return all rounds, with the sums of their counts by database."""
        rows = sorted(self.rows, key=lambda row: (DATABASES.index(row["database"]), row["seed"]))
        summary: dict[str, float] = {}
        for row in rows:
            counts = {"rounds": 1.0} | dict.fromkeys(ZEROS, 0.0) | row["counts"]
            for name, count in counts.items():
                key = f"{row['database']}.{name}"
                summary[key] = summary.get(key, 0.0) + count
        omissions = [f"{row['database']} round {row['seed']}: {one}" for row in rows for one in row["at_fault"]]
        return BenchDocument("faults", rows, omissions, summary)


def _code(revision: str | None) -> str | None:
    """Return a revision without the mark of a changed tree, which writing the document may leave."""
    return revision and revision.removesuffix("-dirty")


@click.command()
@click.option("--rounds", type=click.IntRange(1, 100), default=6, show_default=True)
@click.option("--kills", type=click.IntRange(0, 500), default=50, show_default=True, help="In each round.")
@click.option("--jobs", type=click.IntRange(1, 500), default=15, show_default=True, help="In each round.")
@click.option("--captures", type=click.IntRange(1, 500), default=30, show_default=True, help="In each round.")
@click.option("--database", "databases", type=click.Choice(DATABASES), multiple=True, default=DATABASES)
@click.option("--seed", type=int, default=1, show_default=True, help="Of the first round; the others count on.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(rounds: int, kills: int, jobs: int, captures: int, databases: tuple[str, ...], seed: int, out: Path) -> None:
    """Run the rounds that OUT lacks, the databases side by side, and write the counts of each as it ends."""
    kept = Rounds(out)
    plan = Plan(kills, jobs, captures)

    def run_all(database: str) -> None:
        for one in kept.missing(database, range(seed, seed + rounds)):
            kept.run(database, one, plan)

    with ThreadPoolExecutor(len(databases)) as pool:
        list(pool.map(run_all, databases))
    for name, value in kept.document().summary.items():
        click.echo(f"{name:34} {value:g}")


if __name__ == "__main__":
    main()
