"""Finds by how many ticks each camera sees early or late, from what moves, a few times in a training.

A camera that lags sees what the scene shows a little later. To first order the difference of its image from the render
is the lag times the change of the render within a tick, summed over the pixels that see movers: least squares of one
number a view. What all cameras share is the clock itself, so lags have the mean 0. Letters: V views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.rendering.render import Backend, render
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import SceneModel
from reconstruction.training.image_term import learnt_planes
from reconstruction.training.view import TrainingView
from rigs.clock import RigClock

LOOKS = (0.25, 0.5, 0.75)  # shares of the training; the later ones only where the first has found lags
LEAST_STEPS = 75  # before the first look: in a shorter training a look takes too much of the time
INSTANTS = 4  # of a view that a look compares
STEP = 4.0  # ticks to either side at which a look renders
ALIKE_PX = 25  # pixels in which a model errs alike
ROBUST = 4.0  # deviations beyond which a difference pulls no harder
SURE = 4.0  # standard deviations by which lags must differ to be taken out
LEAST_SPREAD = 0.15  # ticks of spread that is worth it
MOST = 50.0  # ticks beyond which first order tells nothing


@dataclass
class Lags:
    """The lags of V views in ticks, positive where a camera sees what happens later; zeros until they are found.

    `looks` counts the looks so far, `sds` [V] are the standard deviations at the last one, `spread` what it found.
    """

    views: int
    clock: RigClock
    backend: Backend = "native"
    looks: int = 0
    ended: bool = False
    spread: float = 0.0
    ticks: NDArray[np.float64] = field(init=False)
    sds: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        self.ticks, self.sds = np.zeros(self.views), np.full(self.views, np.inf)

    def seen(self, cloud: DynamicCloud, instant_s: float, view: int) -> Instantaneous:
        """Return the cloud as a view has it at an instant (s) of the rig's clock."""
        return cloud.at(instant_s + float(self.ticks[view]) / self.clock.tick_rate_hz)

    def look(self, cloud: SceneModel, views: Sequence[TrainingView], done: float, made: int) -> None:
        """Measure the lags where `done` of the training says that it is time, and take them up where they are sure.

        `made`: steps of the training so far.
        """
        if self.ended or self.looks >= len(LOOKS) or done < LOOKS[self.looks]:
            return
        if made < LEAST_STEPS:
            self.ended = True
            return
        self.looks += 1
        assert isinstance(cloud, DynamicCloud)  # the only models that such views are shown
        steps = np.array([self._step(cloud, view) for view in views], np.float64)
        self.sds = steps[:, 1]
        found = self.ticks + steps[:, 0]
        found -= found.mean()
        self.spread = float(np.sqrt(np.mean(found**2)))
        sd = float(np.sqrt(np.mean(self.sds**2)))
        if np.isfinite(sd) and self.spread > max(LEAST_SPREAD, SURE * sd) and np.abs(found).max() < MOST:
            self.ticks = found
        else:
            self.ended = not self.ticks.any()

    def _step(self, cloud: DynamicCloud, view: TrainingView) -> tuple[float, float]:
        """Return by how much the lag of a view should change, ticks, and its standard deviation."""
        changes, gaps = [], []
        first, last = learnt_planes(cloud, view)
        for plane in np.linspace(first, last - 1, INSTANTS + 2)[1:-1].astype(int).tolist():
            pixels = view.source.moving & ~view.source.useless(plane + 1)
            early, late = (self._light(cloud, view, plane + sign * STEP, pixels) for sign in (-1, 1))
            changes.append((late - early) / (2 * STEP))
            gaps.append(view.source.at(plane)[pixels] - (late + early) / 2)
        change, gap = (np.concatenate(parts).astype(np.float64) for parts in (changes, gaps))
        width = ROBUST * 1.4826 * float(np.median(np.abs(gap))) if len(gap) else 0.0
        pull = np.minimum(1, width / np.maximum(np.abs(gap), 1e-12))
        normal = float(np.sum(pull * change**2))
        if not normal > 1e-12:
            return 0.0, np.inf
        step = float(np.sum(pull * change * gap)) / normal
        sd = np.sqrt(ALIKE_PX * float(np.mean(pull * gap**2)) / normal)
        return step, float(sd)

    def _light(
        self, cloud: DynamicCloud, view: TrainingView, plane: float, pixels: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Return what a view shows at a plane in those of its `pixels` [H, W] that are True, in their order."""
        with torch.no_grad():
            now, only = view.seen(cloud, self.clock.instant_s(plane)), torch.from_numpy(pixels).to(view.device)
            seen = render(now, view.camera, backend=self.backend, dilation_px2=cloud.dilation_px2, only=only)
            return seen.intensity[..., 0].float().cpu().numpy()[pixels]

    def state(self) -> dict:
        """Return plain numbers, for a checkpoint."""
        plain = {"looks": self.looks, "ended": self.ended, "spread": self.spread}
        return plain | {"ticks": self.ticks.tolist(), "sds": self.sds.tolist()}

    def restore(self, state: dict) -> None:
        """Continue from what `state` returned."""
        self.looks, self.ended, self.spread = state["looks"], state["ended"], state["spread"]
        self.ticks, self.sds = np.array(state["ticks"]), np.array(state["sds"])
