"""Fits a model to what the training cameras recorded, one view at one instant a step."""

import copy
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.images.background import dimming
from reconstruction.initialization.sweep import depth_range_m
from reconstruction.methods.definition import Training
from reconstruction.native import kernels_alone
from reconstruction.rendering.render import Backend
from reconstruction.scene_model import SceneModel
from reconstruction.training.averaging import Averages
from reconstruction.training.checkpoint import model_from_state
from reconstruction.training.closeness import Closeness
from reconstruction.training.draws import Draws
from reconstruction.training.ending import Ending
from reconstruction.training.exposure import Exposure
from reconstruction.training.freeing import freed, freed_states
from reconstruction.training.image_term import ImageTerm
from reconstruction.training.lags import Lags
from reconstruction.training.limits import keep_light, keep_sizes
from reconstruction.training.optimizer import AdamStates, anneal, optimizer_of, states_of
from reconstruction.training.ray_term import RAYS, RayTerm
from reconstruction.training.refinement import Refinement
from reconstruction.training.regrouping import GAP_PX, JOINED_AT, bodies_of, regrouped
from reconstruction.training.term import Term, supervisions
from reconstruction.training.view import TrainingView
from rigs.camera import Camera
from rigs.clock import RigClock

USUAL = 1.5  # farthest usual depths, along z, within which a point is an ordinary one
DEAD = 0.005  # opacity below which an element shows nothing
WHOLE_EVERY = 8  # steps from one that looks beyond the focus of its view to the next
LIVING_EVERY = 100  # steps between looks at whether any element is left


@dataclass(frozen=True)
class TrainerSettings:
    """The settings of a training.

    `supervision`: a name of `supervisions()`, or RAYS. `training`: the way of the method. `white`: data range in spikes
    per tick. `tick_stride`: planes between the instants at which images are compared. `image_planes`: planes that a
    target image is the mean of. `refines`: whether poses, gains and lags of the views are learnt too. `times`: whether
    lags alone are looked for, where they are not learnt. `ends_early`: whether a training that no longer gains ends
    before its budget. `doublings`: shares of the training at which pictures become twice as wide and high, in order;
    they are whole after the last. `backend`: native for float32; the reference trains in any float type;
    gsplat on a CUDA `device`, where the model, its optimiser and what it is compared with then lie. `spike_weight`:
    weight of the term on spikes in a step that has the one on images, too; None where such a step has it alone.
    """

    supervision: str
    training: Training = field(default_factory=Training)
    white: float = 0.6
    tick_stride: int = 1
    image_planes: int = 1
    refines: bool = False
    times: bool = False
    ends_early: bool = False
    doublings: tuple[float, ...] = ()
    backend: Backend = "native"
    device: str = "cpu"
    spike_weight: float | None = None


class Trainer:
    """One optimisation; `state` and `restore` carry it over a kill exactly (same steps, same draws).

    `cloud` is what its steps move; `result` is what it has found.
    """

    def __init__(
        self, cloud: SceneModel, views: Sequence[TrainingView], settings: TrainerSettings, clock: RigClock, seed: int
    ):
        self.cloud = _on(settings.device, cloud)
        self.settings = settings
        self.draws = Draws(len(views), seed)
        self.steps = 0
        self.joined: tuple[int, int] | None = None  # how many parts became how many bodies, once they were joined
        self.averages = Averages()
        self.ending = Ending(len(views), settings.training.enough_steps) if settings.ends_early else None
        self.closeness = Closeness(settings.white)
        self.exposure = Exposure(settings.image_planes, clock) if settings.training.deblurs else None
        self.image, self.spikes = _terms(settings, clock, self.closeness, self.exposure)
        self.center = torch.tensor(np.mean([view.camera.center for view in views], axis=0), dtype=torch.float32)
        self.extent_m = extent_m(self.cloud, [view.camera for view in views])
        self.units = {"none": 1.0, "scene": self.extent_m, "light": dimming(settings.white)}
        self.optimizer = optimizer_of(self.cloud, self.units, settings.training.rates)
        cameras, tick_s = [view.camera for view in views], 1 / clock.tick_rate_hz
        self.refinement = Refinement(cameras, self.extent_m, tick_s) if settings.refines else None
        self.lags = Lags(len(views), clock, settings.backend) if settings.times and not settings.refines else None
        self.views = self._corrected(views)

    def _corrected(self, views: Sequence[TrainingView]) -> Sequence[TrainingView]:
        views = [view.on(self.settings.device) for view in views]
        if self.lags:
            return [replace(v, corrected=partial(self.lags.seen, view=i)) for i, v in enumerate(views)]
        if not self.refinement:
            return views
        return [replace(v, corrected=partial(self.refinement.seen, view=i)) for i, v in enumerate(views)]

    def step(self, done: float) -> float:
        """Do one step and return its loss; `done` in [0, 1] is the share of the training before it."""
        way = self.settings.training
        if done >= JOINED_AT and self.joined is None:
            self._join()
        stage = self.cloud.advance(done)
        anneal(self.optimizer, done, stage, self.steps, way.canonical_until)
        if self.exposure:
            self.exposure.look(self.cloud, [view.camera for view in self.views], done)
        if self.lags:
            self.lags.look(self.cloud, self.views, done, self.steps)
        due = self.spikes if self.steps % way.spikes.every == way.spikes.every - 1 else None
        view = self.draws.view()
        self.optimizer.zero_grad(set_to_none=True)
        halvings = 0 if due else sum(done < share for share in self.settings.doublings)
        seen = self.views[view].whole if self.steps % WHOLE_EVERY == 0 else self.views[view]
        loss = self._loss(_halved(seen, halvings), due)
        loss.backward()
        self.optimizer.step()
        keep_light(self.optimizer)
        keep_sizes(self.cloud.tensors(), self.center, self.extent_m)
        self.averages.see(self.cloud.tensors(), stage)
        if self.refinement:
            self.refinement.step(done)
        self.steps += 1
        if self.steps % LIVING_EVERY == 0:
            _refuse_dead(self.cloud, self.steps)
        found = float(loss.detach())
        if self.ending and due is None and halvings == 0 and done >= way.canonical_until:
            self.ending.see(view, found, self.steps, done)
        return found

    def _loss(self, view: TrainingView, spikes: Term[Any] | None) -> Tensor:
        """Return the loss of a step on `view`, with a term on spikes where there is one, and the model's penalty."""
        weight, penalty = self.settings.spike_weight, self.cloud.penalty()
        if spikes and weight is not None:
            loss = self.image(self.cloud, view, self.draws) + weight * spikes(self.cloud, view, self.draws)
        else:
            loss = (spikes or self.image)(self.cloud, view, self.draws)
        return loss if penalty is None else loss + penalty

    def done(self, share: float) -> float:
        """Return the share of the training that is done: `share`, as the budget has it, or more once it ends early."""
        return self.ending.done(share, self.steps) if self.ending else share

    def result(self) -> SceneModel:
        """Return a model of its own that has the means of the last steps."""
        found = model_from_state(self.cloud.state())
        self.averages.put_into(found.tensors())
        return found

    def settle(self) -> None:
        """Leave the means of the last steps in `cloud` itself, where no step follows."""
        self.averages.put_into(self.cloud.tensors())

    def state(self) -> dict:
        """Return all that a resumed training needs, as tensors, numbers and strings."""
        return {
            "cloud": self.cloud.state(),
            "optimizer": self.optimizer.state_dict(),
            "draws": self.draws.state(),
            "averages": self.averages.state(),
            "steps": self.steps,
            "joined": self.joined,
            "ending": self.ending.state() if self.ending else None,
            "passed_px": self.exposure.passed_px if self.exposure else None,
            "refinement": self.refinement.state() if self.refinement else None,
            "lags": self.lags.state() if self.lags else None,
        }

    def restore(self, state: dict) -> None:
        """Continue from `state` as if nothing had happened."""
        self.cloud = _on(self.settings.device, model_from_state(state["cloud"]))
        self.optimizer = optimizer_of(self.cloud, self.units, self.settings.training.rates)
        self.optimizer.load_state_dict(state["optimizer"])
        if "draws" in state:  # not in the checkpoint of an earlier revision
            self.draws.restore(state["draws"])
        self.steps, self.joined = state["steps"], state.get("joined", (0, 0))
        self.averages = Averages(**state.get("averages", {}))  # not in the checkpoint of an earlier revision either
        if self.ending and state.get("ending"):
            self.ending = Ending(**copy.deepcopy(state["ending"]))
        if self.exposure:
            self.exposure.passed_px = state.get("passed_px")
        if self.refinement and state.get("refinement"):
            self.refinement.restore(state["refinement"])
        if self.lags and state.get("lags"):
            self.lags.restore(state["lags"])

    def unsettle(self, views: Sequence[TrainingView], which: Tensor) -> None:
        """Go on with other targets, and with the still Gaussians of the mask `which` [N] as moving ones."""
        old = states_of(self.optimizer, self.cloud)
        moments, begun = freed_states(self.cloud, old, which), torch.tensor(float(self.steps))
        steps = {name: old.get(name, {}).get("step", begun) for name in moments}
        self.views = self._corrected(views)
        self._go_on(freed(self.cloud, which), {name: {"step": steps[name], **own} for name, own in moments.items()})
        if self.ending:
            self.ending = Ending(len(views), self.ending.enough)

    def _join(self) -> None:
        """Go on with one body for all parts that move alike."""
        parts, focal_px = bodies_of(self.cloud), max(view.camera.fx for view in self.views)
        gap_m = GAP_PX * self.extent_m / focal_px
        if found := regrouped(self.cloud, states_of(self.optimizer, self.cloud), gap_m):
            self._go_on(*found)
        self.joined = parts, bodies_of(self.cloud)

    def _go_on(self, cloud: SceneModel, states: AdamStates) -> None:
        """Go on with another cloud, of whose tensors the optimiser knows `states`."""
        self.cloud = cloud
        self.optimizer = optimizer_of(cloud, self.units, self.settings.training.rates, states)
        self.averages.restart()


def _refuse_dead(cloud: SceneModel, steps: int) -> None:
    """Raise ReconstructionError where nothing is left to be seen, and so nothing to learn from."""
    if not (cloud.opacity() >= DEAD).any():
        raise ReconstructionError(
            f"found no {cloud.unit} of opacity {DEAD} or more after {steps} steps",
            "some to learn from",
            "check that the recording is lit and the poses are its own, then start a new run",
        )


def _on(device: str, cloud: SceneModel) -> SceneModel:
    return cloud if device == "cpu" else cloud.to(torch.device(device))


def _halved(view: TrainingView, times: int) -> TrainingView:
    for _ in range(times):
        view = view.halved
    return view


def _terms(
    settings: TrainerSettings, clock: RigClock, closeness: Closeness, exposure: Exposure | None
) -> tuple[Term[Any], Term[Any] | None]:
    """Return the term on images and the one on spikes; which kind of model they take depends on the supervision."""
    if settings.supervision == RAYS:
        return RayTerm(clock, settings.white, closeness=closeness), None
    hold = settings.training.holds_depth
    seen = {"closeness": closeness, "backend": settings.backend, "hold": hold, "exposure": exposure}
    image = ImageTerm(clock, settings.white, settings.tick_stride, **seen)
    return image, supervisions()[settings.supervision].term(image, settings.training.spikes)


def train(trainer: Trainer, done: Callable[[], float], on_step: Callable[[float, float], None]) -> None:
    """Step until `done()` reaches 1, at least once; `on_step(done, loss)` may raise to stop early."""
    fraction = done()
    while True:
        with nullcontext() if trainer.cloud.networks else kernels_alone():
            loss = trainer.step(fraction)
        fraction = done()
        on_step(fraction, loss)
        if fraction >= 1:
            return


def extent_m(cloud: SceneModel, cameras: Sequence[Camera]) -> float:
    """Return the mean distance from the cameras to the points, in m: the unit of lengths that are learnt.

    Points beyond the usual depths do not count, unless there are no others.
    """
    centers = torch.tensor(np.stack([c.center for c in cameras]), dtype=torch.float32)
    points = cloud.positions(cloud.clip.middle_s).detach().cpu()
    near = (points - centers.mean(dim=0)).norm(dim=1) < USUAL * depth_range_m(cameras)[1]
    points = points[near] if near.any() else points
    return float((points.mean(dim=0) - centers).norm(dim=1).mean())
