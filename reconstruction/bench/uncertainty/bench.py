"""Measures expected errors against true ones, at the held-out camera and at views that nobody captured.

Their weights are fitted here, for each scene on all scenes that are not alike, so that no figure is of a scene that was
fitted. Letters: K terms, B blocks of pixels.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress
from acquisition.scenes.catalog import BACKGROUNDS, DEVELOPMENT, build_scene
from reconstruction.bench.contact_sheet import write_sheet
from reconstruction.bench.conventions import HOLDOUT, KnownRecording, means
from reconstruction.bench.viewpoints import SAMPLES, viewpoints
from reconstruction.evaluation.expectation import block_means, rank_correlation
from reconstruction.pipeline.evidence_artefact import read_uncertainty
from reconstruction.report.display import grey
from reconstruction.report.pictures import error_colours
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import load_cloud
from reconstruction.uncertainty.expected_error import WEIGHTS, Uncertainty
from rigs.camera import Camera

HELD_OUT = "held-out"
ALIKE = {*DEVELOPMENT, *BACKGROUNDS} - {"plain"}  # the same things and movers, before other backgrounds
INSTANTS = (0.25, 0.55, 0.8)  # as shares of the clip
PLACES = {("between", 0.1), ("forward", 0.4), ("backward", -0.4), *(("beyond", d) for d in (0.05, 0.1, 0.2, 0.4, 0.8))}
SHOWN = {(HELD_OUT, 0.0), ("beyond", 0.2)}  # the views on the sheet
ROUNDS = 400  # of the fit, at most
FLOOR = 1e-6  # added to every true square of the fit: errors below a thousandth of white are as good as none
LEAST = 1e-9  # added to every expected square, so that none is zero
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SeenView:
    """One view of a run, as `about` says, at some instants: terms [K, B] and true squares [B], over white's square."""

    about: dict[str, str | float]
    terms: Sequence[Floats]
    squares: Sequence[Floats]


def fitted(views: Sequence[SeenView]) -> Floats:
    """Return the weights [K] whose expected squares are nearest to true ones in their logarithms, block by block.

    Each view counts as much as any other. Logarithms look at order more than a likelihood does, which looks at the
    largest errors. What is expected is then as large as what is true, in the mean of the views' logarithms.
    """
    terms = [np.concatenate(view.terms, axis=1) for view in views]
    squares = [np.concatenate(view.squares) for view in views]
    share = np.repeat([1 / len(own) for own in squares], [len(own) for own in squares]) / len(views)
    weights = _nearest(np.concatenate(terms, axis=1), np.concatenate(squares), share)
    pairs = zip(terms, squares, strict=True)
    excess = [np.log((weights @ own + LEAST).mean() / (true.mean() + LEAST)) for own, true in pairs]
    return weights * np.exp(-np.mean(excess))


def _nearest(terms: Floats, squares: Floats, share: Floats) -> Floats:
    """Return the weights [K] above zero of least squared differences of logarithms, of blocks that count by `share`."""
    known, wanted, counted = torch.from_numpy(terms), torch.from_numpy(np.log(squares + FLOOR)), torch.from_numpy(share)
    logs = torch.from_numpy(np.log(squares.mean() / np.maximum(terms.mean(axis=1), LEAST) / len(terms)))
    logs.requires_grad_()
    search = torch.optim.LBFGS([logs], max_iter=ROUNDS, line_search_fn="strong_wolfe")

    def distance() -> float:
        search.zero_grad()
        gap = (counted * ((logs.exp() @ known + LEAST).log() - wanted) ** 2).sum()
        gap.backward()
        return float(gap.detach())

    search.step(distance)
    return logs.detach().exp().numpy()


def kin(scene: str) -> set[str]:
    """Return the scenes whose views tell too much of this one to fit weights for it: itself, and those alike."""
    return ALIKE if scene in ALIKE else {scene}


def scored(view: SeenView, weights: Floats) -> dict[str, float]:
    """Return the true and the expected root mean square over white, their ratio, and the rank correlation of blocks."""
    expected = [weights @ terms + LEAST for terms in view.terms]
    true, said = (float(np.sqrt(np.mean(np.concatenate(found)))) for found in (view.squares, expected))
    ranks = [rank_correlation(a, b) for a, b in zip(expected, view.squares, strict=True)]
    return {"true": true, "expected": said, "ratio": said / max(true, LEAST), "rank": float(np.mean(ranks))}


def bench_uncertainty(
    runs: Sequence[tuple[KnownRecording, RunFolder]], drawn: Sequence[str], sheet: Path, progress: Progress
) -> BenchDocument:
    """Fit on runs and score them; of the scenes `drawn` by a path tracer, which are not fitted, the held-out view."""
    document, views, tiles = BenchDocument("uncertainty"), [], []
    for number, (clip, run) in enumerate(runs):
        progress(number / len(runs), clip.scene)
        cloud = load_cloud(run.checkpoint)
        told = read_uncertainty(run, cloud)
        assert told is not None
        found = list(_held_out(clip, told))
        if clip.scene not in drawn:
            found += list(_elsewhere(clip, run, told))
        views += [view for view, _ in found]
        tiles += [strip for view, strip in found if (view.about["line"], view.about["along_m"]) in SHOWN]
    known = [view for view in views if view.about["scene"] not in drawn]
    for scene in dict.fromkeys(str(view.about["scene"]) for view in views):
        others = [view for view in known if view.about["scene"] not in kin(scene)]
        weights, fitted_on = fitted(others), list(dict.fromkeys(view.about["scene"] for view in others))
        own = [view for view in views if view.about["scene"] == scene]
        document.rows += [{**view.about, **scored(view, weights), "fitted_on": fitted_on} for view in own]
    document.summary = _summary(document.rows, drawn) | _named(fitted(known))
    left_out = "the held-out view alone: elsewhere their truth takes long to draw"
    any_drawn = any(clip.scene in drawn for clip, _ in runs)
    document.omissions.append(f"path-traced scenes: {left_out if any_drawn else 'none was asked for'}")
    write_sheet(sheet, tiles)
    return document


def _named(weights: Floats) -> dict[str, float]:
    return {f"weight.{name}": float(f"{weight:.2g}") for name, weight in zip(WEIGHTS, weights, strict=True)}


def _summary(rows: Sequence[dict], drawn: Sequence[str]) -> dict[str, float]:
    """Return means over scenes by line and centimetres along it, and over path-traced scenes."""
    summary: dict[str, float] = {}
    ours = [row for row in rows if row["scene"] not in drawn]
    for line, along_m in dict.fromkeys((row["line"], row["along_m"]) for row in ours):
        own = [row for row in ours if (row["line"], row["along_m"]) == (line, along_m)]
        name = line if line == HELD_OUT else f"{line}{100 * along_m:+.0f}cm"
        summary |= {f"{name}.{score}": value for score, value in means(own, ("rank", "ratio")).items()}
        summary[f"{name}.worst_rank"] = min(row["rank"] for row in own)
        summary[f"{name}.worst_ratio"] = max((row["ratio"] for row in own), key=lambda ratio: abs(np.log(ratio)))
    path_traced = [row for row in rows if row["scene"] in drawn]
    if path_traced:
        summary |= {f"drawn.{score}": value for score, value in means(path_traced, ("rank", "ratio")).items()}
    return summary


Frame = tuple[float, NDArray[np.float32]]  # an instant in s, and the true light [H, W]
Seen = tuple[SeenView, list]


def _held_out(clip: KnownRecording, told: Uncertainty) -> Iterator[Seen]:
    """Yield the held-out view, beside the truth of its recording."""
    clock, truth = clip.recording.rig.clock, clip.truth
    planes = truth.planes(HOLDOUT)
    chosen = [planes[int(share * (len(planes) - 1))] for share in INSTANTS]
    frames = [(clock.instant_s(plane), truth.frame(HOLDOUT, plane).intensity) for plane in chosen]
    place = {"line": HELD_OUT, "along_m": 0.0, "distance_m": 0.0}
    yield _seen(clip, place, clip.recording.rig.camera(HOLDOUT), frames, told)


def _elsewhere(clip: KnownRecording, run: RunFolder, told: Uncertainty) -> Iterator[Seen]:
    """Yield the views of PLACES, beside a truth that is rendered for them."""
    scene = build_scene(clip.scene, clip.seed)
    instants_s = [told.scene.clip.instant_s(share) for share in INSTANTS]
    for point in viewpoints(clip.recording.rig, run.plan.views, scene.center):
        along_m = round(point.along_m, 2)
        if (point.line, along_m) in PLACES:
            pictures = scene.render(point.camera, np.array(instants_s), SAMPLES).intensity
            place = {"line": point.line, "along_m": along_m, "distance_m": point.distance_m}
            yield _seen(clip, place, point.camera, list(zip(instants_s, pictures, strict=True)), told)


def _seen(clip: KnownRecording, place: dict, camera: Camera, frames: Sequence[Frame], told: Uncertainty) -> Seen:
    """Return a view and, of its middle instant, the tiles of truth, render, true and expected error."""
    terms, squares, tiles, white = [], [], [], told.evidence.white
    for number, (instant_s, wanted) in enumerate(frames):
        seen = told.scene.look(camera, instant_s).intensity
        gap = seen - wanted
        terms.append(np.stack([block_means(term.numpy()).ravel() for term in told.terms(camera, instant_s)]))
        squares.append(block_means(np.square(gap / white)).ravel())
        if number == len(frames) // 2:
            name = f"{clip.scene}, {place['line']} {place['along_m']:g} m"
            tiles = [(name, grey(wanted, white)), ("render", grey(seen, white))]
            tiles += [("error x5", error_colours(gap, white))]
            tiles += [("expected error x5", error_colours(told.look(camera, instant_s), white))]
    return SeenView({"scene": clip.scene, "seed": clip.seed, **place}, terms, squares), tiles
