"""Error against run time of whole reconstructions: recording in, scored centre view out."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.bench.variants import AUTO, BUDGETS_S, CLEAN, HOLDOUT, MIDDLE_S, Variant
from reconstruction.evaluation.evaluate import held_out_camera, score_against_truth, score_floors
from reconstruction.evaluation.truth import Truth
from reconstruction.fields.model import model_from_state
from reconstruction.pipeline.poses import posed
from reconstruction.pipeline.run import reconstruct
from reconstruction.pipeline.stages import composite_sources
from reconstruction.training.checkpoint import load_checkpoint
from reconstruction.training.run import RunFolder

TARGETS_DB = (28, 30, 31, 33, 34)
STAGES = ("plan", "images", "points", "train")
METRICS = ("psnr_db", "ssim", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "delta_1_25")
FLOOR = "depth_blend"
CURVE_INSTANTS = 4  # truth instants behind each point of a curve but the last


@dataclass(frozen=True)
class Clip:
    """A simulated recording and what it is of."""

    scene: str
    seed: int
    path: Path


def bench_training(
    clips: Sequence[Clip], variants: Sequence[Variant], work: Path, progress_of: Callable[[str], Progress]
) -> BenchDocument:
    """Reconstruct each clip by each variant that names its scene, at its budgets; runs lie in `work`.

    The centre camera is held out. A finished run in `work` is not repeated, so that a stopped bench resumes.
    """
    document = BenchDocument("training")
    for variant in variants:
        for clip in (c for c in clips if c.scene in variant.scenes):
            for budget_s in variant.budgets_s:
                out = work / f"{clip.scene}-{clip.seed}-{variant.name}-{budget_s:g}s"
                if not (out / "scores.json").exists():
                    run = reconstruct(clip.path, out, variant.config(budget_s), progress_of, last="train")
                    write_json(out / "scores.json", _scored(run, clip, floors=variant.name == AUTO.name))
                scores = json.loads((out / "scores.json").read_text())
                spent_s = scores["curve"][-1]["seconds"]
                document.rows.append({"method": variant.name, "budget_s": budget_s, "seconds": spent_s, **scores})
        _summarise(document, variant)
    _margins(document)
    return document


def _scored(run: RunFolder, clip: Clip, *, floors: bool) -> dict:
    recording = posed(run, Recording.open(clip.path), refined=True)
    assert recording.truth is not None
    held_out, truth = held_out_camera(recording, HOLDOUT, run.plan.views, Truth.open(recording.truth))
    assert truth is not None
    states = [load_checkpoint(path) for path in run.snapshots()]
    clouds = [model_from_state(state["cloud"]) for state in states]
    last = score_against_truth(clouds[-1], held_out, truth)
    levels = [score_against_truth(cloud, held_out, truth, CURVE_INSTANTS)["psnr_db"] for cloud in clouds[:-1]]
    seconds = run.document["seconds"]
    return {
        "scene": clip.scene,
        "seed": clip.seed,
        "revision": run.document["revision"],
        "model": run.plan.model,
        "steps": run.document["steps"],
        "steps_per_s": run.document["steps"] / seconds["train"],
        **{m: last[m] for m in METRICS if m in last},
        **{f"seconds.{s}": seconds[s] for s in STAGES},
        **(score_floors(held_out, truth, composite_sources(run, recording)) if floors else {}),
        "curve": [
            {"seconds": state["seconds"], "psnr_db": level}
            for state, level in zip(states, [*levels, last["psnr_db"]], strict=True)
        ],
    }


def _rows(document: BenchDocument, method: str, budget_s: float | None = None) -> list[dict]:
    return [r for r in document.rows if r["method"] == method and budget_s in (None, r["budget_s"])]


def _summarise(document: BenchDocument, variant: Variant) -> None:
    """Means over the scenes at each budget."""
    for budget_s in variant.budgets_s:
        rows = _rows(document, variant.name, budget_s)
        for metric in METRICS:
            found = [r[metric] for r in rows if metric in r]
            if found:
                document.summary[f"{variant.name}.{metric}@{budget_s:g}"] = float(np.mean(found))
        if rows:
            speeds = [r["steps_per_s"] for r in rows]
            document.summary[f"{variant.name}.steps_per_s@{budget_s:g}"] = float(np.mean(speeds))
    if variant.name == AUTO.name:
        _times_to(document)


def _times_to(document: BenchDocument) -> None:
    """The mean over recordings of the first second at which any run of it reached a level, where all did."""
    curves: dict[tuple[str, int], list[dict]] = {}
    for row in _rows(document, AUTO.name):
        curves.setdefault((row["scene"], row["seed"]), []).extend(row["curve"])
    for target in TARGETS_DB:
        reached = [[p["seconds"] for p in points if p["psnr_db"] >= target] for points in curves.values()]
        if reached and all(reached):
            document.summary[f"{AUTO.name}.seconds_to_{target}"] = float(np.mean([min(s) for s in reached]))
        else:
            document.omissions.append(f"{target} dB: reached on {sum(map(bool, reached))} of {len(reached)} recordings")


def _margins(document: BenchDocument) -> None:
    """How far the engine lies above the floor on its worst scene, below clean images and above 4DGS on TFI images."""
    longest = BUDGETS_S[-1]
    for budget_s in BUDGETS_S:
        above = [r["psnr_db"] - r[f"{FLOOR}.psnr_db"] for r in _rows(document, AUTO.name, budget_s)]
        if above:
            document.summary[f"margin.floor@{budget_s:g}"] = float(min(above))
    for name, other, sign, budget_s in (("clean", CLEAN.name, -1, longest), ("4dgs", "4dgs", 1, MIDDLE_S)):
        pairs = [
            sign * (a["psnr_db"] - b["psnr_db"])
            for a in _rows(document, AUTO.name, budget_s)
            for b in _rows(document, other, budget_s)
            if (a["scene"], a["seed"]) == (b["scene"], b["seed"])
        ]
        if pairs:
            document.summary[f"margin.{name}@{budget_s:g}"] = float(np.mean(pairs))
    floors = _rows(document, AUTO.name, longest)
    for floor in ("nearest_view", FLOOR):
        for metric in ("psnr_db", "dynamic_psnr_db"):
            found = [r[f"{floor}.{metric}"] for r in floors if f"{floor}.{metric}" in r]
            if found:
                document.summary[f"{floor}.{metric}"] = float(np.mean(found))
