"""Fits a dynamic cloud to target images at random instants of random views."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from acquisition.members import members
from reconstruction.errors import ReconstructionError
from reconstruction.rendering.render import Backend
from reconstruction.scene_model import SceneModel
from reconstruction.training.adam import BETAS, EPS, Adam
from reconstruction.training.checkpoint import model_from_state
from reconstruction.training.closeness import Closeness
from reconstruction.training.depth_hold import DepthHold
from reconstruction.training.ending import Ending
from reconstruction.training.exposure import Exposure
from reconstruction.training.image_term import ImageTerm
from reconstruction.training.ray_term import RAYS, RayTerm
from reconstruction.training.refinement import Correction, Refinement
from reconstruction.training.term import SpikeSampling, Supervision, Term
from reconstruction.training.view import TrainingView
from reconstruction.training.watch import FRESH, freed, set_moving
from rigs.clock import RigClock

FINAL_LENGTH, FINAL = 0.05, 1 / 3  # share of its first rate that a tensor of lengths, and any other, ends with
FULL_WHITE = 0.3  # spikes per tick; in a dimmer scene a step of light is a smaller one
DEAD = 0.005  # opacity below which a Gaussian is not rendered to any effect
LIVING_EVERY = 100  # steps between looks at whether any is left
SUPERVISIONS = members("reconstruction.training.supervision", Supervision)


@dataclass(frozen=True)
class TrainerSettings:
    """`white`: data range in spikes per tick.

    `tick_stride`: planes between the instants that images are compared at.
    `spike_every`: steps between those of the spike term that `supervision` names; `pixels` has none.
    `spike_px`: width and height of the part of a view it looks at (None: all). `spike_planes`: its shortest and longest
    window.
    `ends_early`: whether a training that no longer gains ends before its budget. `refines`: whether poses, gains and
    lags of the views are learnt too.
    `holds_depth`: weight of the loss on depths that the points stage confirmed; 0 is none.
    `image_planes`: planes that a target image is the mean of. `deblurs`: whether renders are too, where movers get far.
    `backend`: native for float32; the reference trains in any float type.
    `canonical_until`: share of the training before a field begins to deform (3,000 of 17,000 steps in 4DGS).
    """

    supervision: str
    white: float = 0.6
    tick_stride: int = 1
    spike_every: int = 2
    spike_px: tuple[int, int] | None = (160, 128)
    spike_planes: tuple[int, int] = (8, 33)
    canonical_until: float = 3 / 17
    ends_early: bool = False
    refines: bool = False
    holds_depth: float = 0.0
    image_planes: int = 1
    deblurs: bool = False
    backend: Backend = "native"


class Trainer:
    """One optimisation; `state` and `restore` carry it over a kill exactly (same steps, same draws)."""

    def __init__(
        self,
        cloud: SceneModel,
        views: Sequence[TrainingView],
        settings: TrainerSettings,
        clock: RigClock,
        seed: int,
    ):
        self.cloud = cloud
        self.settings = settings
        self.rng = np.random.default_rng(seed)
        self.steps = 0
        self.ending = Ending(len(views)) if settings.ends_early else None
        self.closeness = Closeness(settings.white)
        self.exposure = Exposure(settings.image_planes, clock) if settings.deblurs else None
        self.image, self.spikes = _terms(settings, clock, self.closeness, self.exposure)
        self.extent_m = _extent_m(cloud, views)
        self.units = {"none": 1.0, "scene": self.extent_m, "light": min(1.0, settings.white / FULL_WHITE)}
        self.optimizer = _optimizer(cloud, self.units)
        cameras, tick_s = [view.camera for view in views], 1 / clock.tick_rate_hz
        self.refinement = Refinement(cameras, self.extent_m, tick_s) if settings.refines else None
        self.views = self._corrected(views)

    def _corrected(self, views: Sequence[TrainingView]) -> Sequence[TrainingView]:
        """The views with their corrections, where there are any."""
        if not self.refinement:
            return views
        return [replace(view, correction=Correction(self.refinement, i)) for i, view in enumerate(views)]

    def step(self, done: float) -> float:
        """One update; `done` in [0, 1] is how much of the training lies behind, which sets the rates."""
        self._anneal(done, self.cloud.advance(done))
        if self.exposure:
            self.exposure.look(self.cloud, [view.camera for view in self.views], done)
        every = self.settings.spike_every
        due = self.spikes if self.steps % every == every - 1 else None
        view = int(self.rng.integers(len(self.views)))
        self.optimizer.zero_grad(set_to_none=True)
        loss = (due or self.image)(self.cloud, self.views[view], self.rng)
        penalty = self.cloud.penalty()
        if penalty is not None:
            loss = loss + penalty
        loss.backward()
        self.optimizer.step()
        if self.refinement:
            self.refinement.step(done)
        self.steps += 1
        if self.steps % LIVING_EVERY == 0:
            self._refuse_dead()
        found = float(loss.detach())
        if self.ending and due is None and done >= self.settings.canonical_until:
            self.ending.see(view, found, self.steps, done)
        return found

    def _refuse_dead(self) -> None:
        """Raise ReconstructionError where nothing is left to be seen, and so nothing to learn from."""
        if not (self.cloud.opacity() >= DEAD).any():
            raise ReconstructionError(
                f"found no {self.cloud.unit} of opacity {DEAD} or more after {self.steps} steps",
                "some to learn from",
                "check that the recording is lit and the poses are its own, then start a new run",
            )

    def done(self, share: float) -> float:
        """How much of the training lies behind, where the budget says `share`: more once it ends early."""
        return self.ending.done(share, self.steps) if self.ending else share

    def _anneal(self, done: float, stage: float) -> None:
        """Rates at `done` of the training; of what moves, at its `stage`."""
        for group in self.optimizer.param_groups:
            begun = not group["field"] or done >= self.settings.canonical_until
            share = min(max(stage if group["moves"] else done, 0.0), 1.0)
            group["lr"] = group["start"] * group["end"] ** share if begun else 0.0

    def state(self) -> dict:
        """Everything a resumed training needs, as tensors, numbers and strings."""
        return {
            "cloud": self.cloud.state(),
            "optimizer": self.optimizer.state_dict(),
            "rng": json.dumps(self.rng.bit_generator.state),
            "steps": self.steps,
            "ending": self.ending.state() if self.ending else None,
            "passed_px": self.exposure.passed_px if self.exposure else None,
            "refinement": self.refinement.state() if self.refinement else None,
        }

    def restore(self, state: dict) -> None:
        """Continue from `state` as if nothing had happened."""
        self.cloud = model_from_state(state["cloud"])
        self.optimizer = _optimizer(self.cloud, self.units)
        self.optimizer.load_state_dict(state["optimizer"])
        self.rng.bit_generator.state = json.loads(state["rng"])
        self.steps = state["steps"]
        if self.ending and state.get("ending"):
            self.ending = Ending.from_state(state["ending"])
        if self.exposure:
            self.exposure.passed_px = state.get("passed_px")
        if self.refinement and state.get("refinement"):
            self.refinement.restore(state["refinement"])

    def unsettle(self, views: Sequence[TrainingView], which: Tensor) -> None:
        """Go on with other targets, and with the still Gaussians of the mask `which` [N] as moving ones.

        Adam's moments are carried over; those of a motion that a Gaussian did not have before are zero.
        """
        names = {id(tensor): name for name, tensor in self.cloud.tensors()}
        old = {names[id(leaf)]: self.optimizer.state[leaf] for g in self.optimizer.param_groups for leaf in g["params"]}
        moments = {
            key: set_moving(
                {n: old[n][key] if old.get(n) else torch.zeros_like(t) for n, t in self.cloud.tensors()},
                which,
                dict.fromkeys(FRESH, 0.0),
            )
            for key in ("exp_avg", "exp_avg_sq")
        }
        begun = torch.tensor(float(self.steps))
        self.views, self.cloud = self._corrected(views), freed(self.cloud, which)
        self.optimizer = _optimizer(self.cloud, self.units)
        for name, tensor in self.cloud.tensors():
            if tensor.requires_grad:
                state = {key: moments[key][name].clone() for key in moments}
                self.optimizer.state[tensor] = {"step": old.get(name, {}).get("step", begun).clone(), **state}
        if self.ending:
            self.ending.begin_again()


def _terms(
    settings: TrainerSettings, clock: RigClock, closeness: Closeness, exposure: Exposure | None
) -> tuple[Term, Term | None]:
    hold = DepthHold(settings.holds_depth) if settings.holds_depth else None
    seen = {"closeness": closeness, "backend": settings.backend, "hold": hold, "exposure": exposure}
    image = ImageTerm(clock, settings.white, settings.tick_stride, **seen)
    if settings.supervision == RAYS:
        return RayTerm(clock, settings.white, closeness=closeness), None
    sampling = SpikeSampling(settings.spike_planes, settings.spike_px)
    return image, SUPERVISIONS[settings.supervision].term(image, sampling)


def train(
    trainer: Trainer,
    done: Callable[[], float],
    on_step: Callable[[float, float], None],
) -> None:
    """Step until `done()` reaches 1, at least once; `on_step(done, loss)` may raise to stop early."""
    fraction = done()
    while True:
        loss = trainer.step(fraction)
        fraction = done()
        on_step(fraction, loss)
        if fraction >= 1:
            return


def _optimizer(cloud: SceneModel, units: Mapping[str, float]) -> torch.optim.Optimizer:
    """Return Adam over the tensors that have a rate; `units` says what a rate of each unit is multiplied by."""
    groups, rates = [], cloud.rates()
    for name, tensor in cloud.tensors():
        if tensor.numel() == 0 or name not in rates:
            continue
        tensor.requires_grad_(True)
        rate = rates[name]
        start, end = rate.start * units[rate.unit], FINAL_LENGTH if rate.unit == "scene" else FINAL
        flags = {"field": rate.deforms, "moves": not name.startswith("still")}
        groups.append({"params": [tensor], "lr": start, "start": start, "end": end, **flags})
    if all(tensor.dtype == torch.float32 for group in groups for tensor in group["params"]):
        return Adam(groups)
    return torch.optim.Adam(groups, betas=BETAS, eps=EPS)


def _extent_m(cloud: SceneModel, views: Sequence[TrainingView]) -> float:
    """Mean distance from the cameras to the points: what a length is measured against."""
    centers = torch.tensor(np.stack([v.camera.center for v in views]), dtype=torch.float32)
    points = cloud.positions(cloud.clip.middle_s).detach()
    return float((points.mean(dim=0) - centers).norm(dim=1).mean())
