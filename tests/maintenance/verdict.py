"""Judges what a campaign of faults left: every job done once, no stage done twice, nothing running, locked or torn."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from reconstruction.run.configuration import STAGES
from reconstruction.run.parts import PartFolder
from server.schemas.jobs import Artefact, Job


def read_trace(job: Path) -> dict[str, int]:
    """Counts of a job's trace: `begun` and `ended` stages, `completed` runs, and what was done again without a restart.

    A stage is finished when run.json says so. `repeated` ones had ended and worked again; `reopened` ones were begun
    although they were finished. Both should be 0, but only the first is lost time. `missing` ones, and parts of a
    training, are not finished.

    A begin with a higher number is a restart: that stage and the later ones may be done again.
    """
    run = job / "run" / "run.json"
    finished = json.loads(run.read_text())["seconds"] if run.exists() else {}
    ended: set[str] = set()
    counts = {"begun": 0, "ended": 0, "completed": 0, "repeated": 0, "reopened": 0}
    newest = 0
    for line in (job / "trace.txt").read_text().splitlines() if (job / "trace.txt").exists() else ():
        word, stage, again, left, _ = line.split()
        if word == "part":
            continue
        if word == "end":
            ended.add(stage)
            counts["ended"] += 1
            counts["completed"] += stage == STAGES[-1]
            continue
        counts["begun"] += 1
        if int(again) > newest:
            newest = int(again)
            ended -= set(STAGES[STAGES.index(stage) :])
        counts["repeated"] += stage in ended and int(left) > 0
        counts["reopened"] += int(left) == 0
    return counts | {"missing": len(set(STAGES) - set(finished)) + len(_unlearnt(job / "run"))}


def _unlearnt(run: Path) -> set[str]:
    """Parts of a training that are neither there nor given up."""
    folder = PartFolder(run)
    return {part.name for part in folder.noted()} - folder.there() - folder.given_up()


def judge_jobs(
    data: Path, accepted: Sequence[str], known: Mapping[str, Job], artefacts: Mapping[str, list[Artefact]]
) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Return a row for each accepted job, and the counts; `known` are the jobs that the service tells of."""
    rows = []
    for job_id in accepted:
        folder = data / "jobs" / job_id
        row = {"job": job_id, "status": known[job_id].status if job_id in known else "lost", **read_trace(folder)}
        rows.append(row | {"torn": torn(folder, artefacts.get(job_id, []))})
    return rows, {
        "jobs": float(len(accepted)),
        "lost": float(sum(row["status"] == "lost" for row in rows) + len(set(known) - set(accepted))),
        "undone": float(sum(row["status"] != "done" or row["missing"] > 0 for row in rows)),
        "repeated": float(sum(row["repeated"] for row in rows)),
        "reopened": float(sum(row["reopened"] for row in rows)),
        "torn": float(sum(len(row["torn"]) for row in rows)),
    }


def torn(job: Path, artefacts: list[Artefact]) -> list[str]:
    """Artefacts that are not what the catalogue says, and documents that are no JSON."""
    run = job / "run"
    bad = [one.name for one in artefacts if hashlib.sha256((run / one.name).read_bytes()).hexdigest() != one.sha256]
    for path in run.glob("*.json"):
        try:
            json.loads(path.read_text())
        except ValueError:
            bad.append(path.name)
    return bad
