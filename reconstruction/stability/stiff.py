"""Trains briefly on the stiff scenes: spread over seeds, float32 against float64, kill and resume, baselines.

All trainings of a scene take the same number of steps; those of one seed draw the same views and instants, whatever the
float type. The centre camera is held out. float64 is rendered, and its motion evaluated, by the torch references.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from acquisition.devices.open import Simulation
from acquisition.native import code_path, code_paths
from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.bench.conventions import HOLDOUT
from reconstruction.bench.score_run import held_out_with_truth
from reconstruction.evaluation.evaluate import score_against_truth
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.pipeline.stages import reconstruct
from reconstruction.pipeline.train_stage import trainer_of
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.models import model_names
from reconstruction.stability.probe import natives
from reconstruction.tensors import write_tensors
from reconstruction.training.checkpoint import load_checkpoint
from reconstruction.training.trainer import Trainer
from rigs.toml import catalog_rig

TRUTH_INSTANTS = 4
SPREAD_DB = 2.0  # dB between seeds at most, with so few Gaussians and steps; worst measured 2.4, on `burst`
APART_DB = 0.1  # dB between float32 and float64 at most
FALLS_TO = 0.95  # last losses over the first ones, at most; worst measured 0.88, on `flicker`
ENDS = 10  # number of first losses, and of last ones


@dataclass(frozen=True)
class Extent:
    """The extent of the trainings: scenes with their planes, size [width, height], Gaussians, steps, seeds."""

    planes: dict[str, int]
    size: tuple[int, int]
    gaussians: int
    steps: int
    seeds: tuple[int, ...]


FULL = Extent({"stiff": 200, "flicker": 200, "burst": 200, "bright": 200, "dim": 1000}, (64, 41), 400, 100, (0, 1, 2))


class Trained(NamedTuple):
    """The loss of every step, and the score of the held-out view."""

    losses: tuple[float, ...]
    psnr_db: float


@dataclass
class StiffScene:
    """A scene recorded in `folder`; each of its trainings runs once, when it is first asked for."""

    name: str
    folder: Path
    extent: Extent
    done: dict[tuple, Trained] = field(default_factory=dict)

    @cached_property
    def recording(self) -> Recording:
        """The simulated recording, with its truth."""
        planes, path = self.extent.planes[self.name], self.folder / self.name
        simulation = Simulation(self.name, seed=1, truth_every=planes // TRUTH_INSTANTS)
        simulate(simulation, catalog_rig("ci3x3").scaled(*self.extent.size), planes, path)
        return Recording.open(path)

    def run(self, seed: int, model: str) -> RunFolder:
        """Return a run folder that is ready for training."""
        extent, in_one = self.extent, self.extent.planes[self.name]
        config = ReconstructionConfig(
            model,
            holdout=HOLDOUT,
            budget_s=None,
            steps=extent.steps,
            seed=seed,
            gaussians=extent.gaussians,
            span=in_one,
        )
        path = self.folder / f"{self.name}-{model}-{seed}"
        return reconstruct(self.recording.path, path, config, lambda _: silent, last="points")

    def trained(self, seed: int, model: str = "auto", *, exact: bool = False, path: str | None = None) -> Trained:
        """Train in float32 by a code path of the kernels (None: the best one), or in float64 by the references."""
        key = (seed, model, exact, path or code_paths()[-1])
        if key not in self.done:
            with code_path(key[-1]):
                self.done[key] = self._train(seed, model, exact=exact)
        return self.done[key]

    def _train(self, seed: int, model: str, *, exact: bool) -> Trained:
        run = self.run(seed, model)
        how = ("reference", torch.float64) if exact else ("native", torch.float32)
        trainer = trainer_of(run, self.recording, *how)
        losses = _stepped(trainer, 0, self.extent.steps, self.extent.steps)
        found = trainer.result()
        cloud = found.to(torch.float32) if isinstance(found, DynamicCloud) else found
        scored = score_against_truth(cloud, *held_out_with_truth(self.recording, run.plan.views))
        return Trained(losses, scored["psnr_db"])


def _stepped(trainer: Trainer, first: int, last: int, steps: int) -> tuple[float, ...]:
    return tuple(trainer.step(step / steps) for step in range(first, last))


def _seeds(scene: StiffScene) -> Observation:
    scores = [scene.trained(seed).psnr_db for seed in scene.extent.seeds]
    said = f"{', '.join(f'{s:.2f}' for s in scores)} dB, standard deviation {np.std(scores):.2f}"
    return Observation(said, max(scores) - min(scores))


def _precision(scene: StiffScene, path: str) -> Observation:
    seed = scene.extent.seeds[0]
    found, expected = scene.trained(seed, path=path), scene.trained(seed, exact=True)
    losses = np.array([found.losses, expected.losses])
    gaps = np.abs(losses[0] / losses[1] - 1)
    said = f"losses {gaps[0]:.0e} apart at first, {gaps.max():.1e} at most; "
    said += f"{found.psnr_db:.3f} dB, {expected.psnr_db:.3f} in float64"
    return Observation(said, abs(found.psnr_db - expected.psnr_db) if np.isfinite(losses).all() else math.inf)


def _resumed(scene: StiffScene) -> Observation:
    """Train half, keep it on disk, load it into a new trainer, and train the other half."""
    seed, steps = scene.extent.seeds[0], scene.extent.steps
    run, kept = scene.run(seed, "auto"), scene.folder / f"{scene.name}.pt"
    first, second = (trainer_of(run, scene.recording) for _ in range(2))
    losses = _stepped(first, 0, steps // 2, steps)
    write_tensors(kept, first.state())
    second.restore(load_checkpoint(kept))
    losses += _stepped(second, steps // 2, steps, steps)
    gap = float(np.abs(np.array(losses) - scene.trained(seed).losses).max())
    return Observation(f"killed at step {steps // 2}: losses {gap:.0e} apart", gap)


def _baseline(scene: StiffScene, model: str) -> Observation:
    found = scene.trained(scene.extent.seeds[0], model)
    ends = np.mean(found.losses[:ENDS]), np.mean(found.losses[-ENDS:])
    said = f"loss {ends[0]:.3f} to {ends[1]:.3f}, {found.psnr_db:.2f} dB"
    return Observation(said, float(ends[1] / ends[0]) if np.isfinite(found.losses).all() else math.inf)


def stiff_cases(scene: StiffScene) -> tuple[Case, ...]:
    """Return the cases of one scene."""
    name, count = scene.name, len(scene.extent.seeds)

    def case(kind: str, expected: str, tolerance: float, observe: Callable[[str], Observation], on: tuple) -> Case:
        return Case(None, f"{name}: {kind}", expected, tolerance, observe, lambda: on)

    within, cost = f"within {SPREAD_DB:g} dB", f"{APART_DB:g} dB apart at most"
    falls = f"losses below {FALLS_TO:g} of the first"
    return (
        case(f"{count} seeds", within, SPREAD_DB, lambda _: _seeds(scene), natives()[-1:]),
        case("float32", cost, APART_DB, lambda on: _precision(scene, on.split()[1]), natives()),
        case("killed and resumed", "the same losses", 0.0, lambda _: _resumed(scene), natives()[-1:]),
        case("trains", falls, FALLS_TO, lambda model: _baseline(scene, model), model_names()),
    )


def curves(scene: StiffScene) -> dict[str, tuple[float, ...]]:
    """Return the loss curves in float32 and float64, of the trainings that ran."""
    seed, best = scene.extent.seeds[0], code_paths()[-1]
    keys = {"float32": (seed, "auto", False, best), "float64": (seed, "auto", True, best)}
    return {name: scene.done[key].losses for name, key in keys.items() if key in scene.done}
