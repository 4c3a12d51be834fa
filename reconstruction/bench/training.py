"""Error against run time of whole reconstructions: recording in, scored centre view out."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress
from reconstruction.pipeline.run import STAGES, reconstruct
from reconstruction.training.config import ReconstructionConfig

BUDGETS_S = (30.0, 60.0, 120.0)
TARGETS_DB = (25, 27, 28, 30)
METRICS = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25")
FLOORS = {"nearest_view": METRICS[:3], "depth_blend": METRICS}  # the nearest view knows no depth


def bench_training(
    recordings: Sequence[tuple[str, int, Path]],
    budgets_s: Sequence[float],
    work: Path,
    progress_of: Callable[[str], Progress],
) -> BenchDocument:
    """Reconstruct each (scene, seed, recording) once a budget with the centre camera held out; runs lie in `work`.

    A finished run in `work` is not repeated, so that a stopped bench resumes.
    """
    document = BenchDocument("training")
    for scene, seed, recording in recordings:
        for budget_s in budgets_s:
            out = work / f"{scene}-{seed}-{budget_s:g}s"
            if not _finished(out):
                reconstruct(recording, out, ReconstructionConfig(holdout="cam11", budget_s=budget_s), progress_of)
            document.rows.append({"scene": scene, "seed": seed, **_row(out, budget_s)})
    for budget_s in budgets_s:
        rows = [r for r in document.rows if r["budget_s"] == budget_s]
        document.summary |= {f"{rows[0]['method']}.{m}@{budget_s:g}": _median(rows, m) for m in METRICS}
    floors = [f"{floor}.{metric}" for floor, metrics in FLOORS.items() for metric in metrics]
    document.summary |= {name: _median(document.rows, name) for name in floors}
    _times_to(document)
    longest = [r for r in document.rows if r["budget_s"] == max(budgets_s)]
    document.summary |= {f"seconds.{s}": _median(longest, f"seconds.{s}") for s in STAGES}
    document.summary["steps_per_s"] = _median(longest, "steps_per_s")
    return document


def _finished(out: Path) -> bool:
    return (out / "run.json").exists() and json.loads((out / "run.json").read_text())["status"] == "finished"


def _row(out: Path, budget_s: float) -> dict:
    run, metrics = (json.loads((out / f"{name}.json").read_text()) for name in ("run", "metrics"))
    curve = json.loads((out / "error_vs_time.json").read_text())["rows"]
    return {
        "method": run["plan"]["model"],
        "revision": run["revision"],
        "budget_s": budget_s,
        "seconds": curve[-1]["seconds"],
        "steps": run["steps"],
        "steps_per_s": run["steps"] / run["seconds"]["train"],
        **{m: metrics[m] for m in METRICS},
        **{f"{f}.{m}": metrics[f"{f}.{m}"] for f, names in FLOORS.items() for m in names},
        **{f"seconds.{s}": run["seconds"][s] for s in STAGES},
        "curve": [{"seconds": r["seconds"], "psnr_db": r["psnr_db"]} for r in curve],
    }


def _times_to(document: BenchDocument) -> None:
    """Median over recordings of the first moment any run of it reached a target; an unreached one is an omission."""
    recordings = {(r["scene"], r["seed"]) for r in document.rows}
    model = document.rows[0]["method"]
    for target in TARGETS_DB:
        firsts = []
        for key in recordings:
            points = [p for r in document.rows if (r["scene"], r["seed"]) == key for p in r["curve"]]
            reached = [p["seconds"] for p in points if p["psnr_db"] >= target]
            firsts += [min(reached)] if reached else []
        if len(firsts) == len(recordings):
            document.summary[f"{model}.seconds_to_{target}"] = float(np.median(firsts))
        else:
            document.omissions.append(f"{target} dB: reached on {len(firsts)} of {len(recordings)} recordings")


def _median(rows: Sequence[dict], key: str) -> float:
    return float(np.median([row[key] for row in rows]))
