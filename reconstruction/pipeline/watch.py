"""Watches a training: once, after a part of it, the plan's still pixels are held against the spikes again."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray

from reconstruction.methods.catalogue import METHODS
from reconstruction.pipeline.artefacts import MOVING, short_images
from reconstruction.run.decisions import Decision
from reconstruction.run.folder import RunFolder
from reconstruction.training.changed_pixels import look_again, unsettled
from reconstruction.training.trainer import Trainer
from reconstruction.training.view import TrainingView

WATCH_AT = 0.25  # share of the training
UNDONE = "straight paths for what the plan took for still"


class Watch:
    """The watch of one training. Its `state` is None until it has looked, and part of every checkpoint from then on.

    The checkpoint comes first and the run folder follows it, so that a training killed between them loses nothing.
    """

    def __init__(self, run: RunFolder, trainer: Trainer):
        self.run, self.trainer = run, trainer
        self.state: dict | None = None

    @property
    def note(self) -> str:
        """The end of a line of progress that says what was undone; empty where nothing was."""
        return f"; watch: {self.state['choice']}" if self.state and self.state["masks"] else ""

    def look(self, done: float, checkpoint: Callable[[], None]) -> None:
        """Look once `done` reaches WATCH_AT; what changes is undone, kept by `checkpoint`, then in the run folder."""
        if self.state is not None or not WATCH_AT <= done < 1:
            return
        asked = self.run.config.model
        obeys = asked != "auto" and not METHODS[asked].watched
        views = self.trainer.views
        changed = {} if obeys else look_again(views)
        masks = {i: views[i].source.moving | mask for i, mask in changed.items()}
        pixels, freed = sum(int(mask.sum()) for mask in changed.values()), 0
        if changed:
            cloud = self.trainer.cloud
            still = cloud.positions(cloud.clip.first_s)[: len(cloud.still)]
            which = unsettled(still, [view.camera for view in views], changed)
            freed = int(which.sum())
            self.trainer.unsettle(self._retargeted(masks), which)
            choice = f"{pixels} pixels of {len(changed)} views move after all, {freed} Gaussians with them"
            reason = f"spikes pooled over still pixels change; they get short images from step {self.trainer.steps} on"
        else:
            choice = f"obeys --model {asked}" if obeys else "nothing undone"
            reason = "what was asked for is not undone" if obeys else f"still pixels of {len(views)} views stay so"
        packed = {views[i].camera.id: torch.from_numpy(np.packbits(mask)) for i, mask in masks.items()}
        facts = {"pixels": pixels, "views": len(changed), "gaussians": freed, "step": self.trainer.steps}
        self.state = {"masks": packed, "choice": choice, "reason": reason, "facts": facts}
        if masks:
            checkpoint()
        self._write(self.state)

    def resume(self, state: dict | None) -> None:
        """Carry on after a watch that a checkpoint tells of."""
        self.state = state
        if state is None:
            return
        numbers = {view.camera.id: i for i, view in enumerate(self.trainer.views)}
        masks = {numbers[name]: self._unpacked(name, packed.numpy()) for name, packed in state["masks"].items()}
        self.trainer.views = self._retargeted(masks)
        self._write(state)

    def _unpacked(self, name: str, packed: NDArray[np.uint8]) -> NDArray[np.bool_]:
        camera = next(view.camera for view in self.trainer.views if view.camera.id == name)
        bits = np.unpackbits(packed, count=camera.width * camera.height)
        return bits.reshape(camera.height, camera.width).astype(bool)

    def _retargeted(self, masks: Mapping[int, NDArray[np.bool_]]) -> list[TrainingView]:
        """Return the training views with the pixels of `masks`, by the number of the view, as moving ones."""
        views = list(self.trainer.views)
        for i, moving in masks.items():
            retargeted = views[i].source.retargeted(moving, partial(short_images, self.run.plan))
            known = views[i].inverse_depth
            known = None if known is None else known * torch.from_numpy(~moving).to(known.device)
            views[i] = replace(views[i], source=retargeted, inverse_depth=known)
        return views

    def _write(self, state: dict) -> None:
        """Bring masks and plan of the run folder up to what the checkpoint says; the same again where they are."""
        sources = {view.camera.id: view.source for view in self.trainer.views}
        for name, packed in state["masks"].items():
            moving = sources[name].recorded_mask(self._unpacked(name, packed.numpy()))
            self.run.write_array(MOVING.format(view=name), moving)
        override = "none"
        if state["masks"]:
            override = "--model static"
            if self.run.plan.model == "static":
                self.run.amend("train", Decision("motion", "linear", UNDONE, "--model"), model="linear")
        facts = state.get("facts", {})  # none in the checkpoint of an earlier revision
        self.run.amend("train", Decision("watch", state["choice"], state["reason"], override, facts=facts))
