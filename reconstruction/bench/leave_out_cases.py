"""Lists the cases of the leave-out bench: a plan, an engine that leaves out nothing, and single decisions switched.

Clips are small, 200x125 and mostly 200 planes, with as many Gaussians a pixel as a run of 400x250 has. Compare their
figures with one another, not with those of other benches.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from reconstruction.bench.conventions import HOLDOUT, VIEWS
from reconstruction.run.configuration import ReconstructionConfig

SIZE, TICKS = (200, 125), 200
GAUSSIANS = 12_000
STEPS, QUICK_STEPS, BUDGET_S = 400, 40, 10.0
DEAD = "cam00"


@dataclass(frozen=True)
class Arm:
    """One way to run a case: `choices` are fields of the configuration that differ from the default.

    `everywhere`: every pixel is taken to move. `channels`: number of the Gaussians' channels; where it is given, the
    training alone is measured, from the first snapshot of a run by the plan.
    """

    name: str
    choices: dict[str, Any] = field(default_factory=dict)
    everywhere: bool = False
    channels: int | None = None

    def config(self, *, steps: int | None = None, budget_s: float | None = None) -> ReconstructionConfig:
        """Return the configuration of a run of so many steps, or to a budget in seconds."""
        kind: dict[str, Any] = {"holdout": HOLDOUT, "gaussians": GAUSSIANS} | self.choices
        return ReconstructionConfig(steps=steps, budget_s=budget_s, **kind)


@dataclass(frozen=True)
class Case:
    """A recording of `ticks` planes, and the arm that decides otherwise for each decision that it tests (`switches`).

    `dead`: a camera whose planes are empty. `everything`: choices of the arm `all` beyond EVERYTHING.
    """

    name: str
    scene: str
    seed: int
    switches: dict[str, Arm]
    ticks: int = TICKS
    dead: str | None = None
    everything: dict[str, Any] = field(default_factory=dict)

    @property
    def all(self) -> Arm:
        """The run that leaves out nothing."""
        return Arm("all", EVERYTHING | self.everything, everywhere=True)


EVERYTHING: dict[str, Any] = {
    "model": "linear",
    "init": "natural",
    "images": "adaptive",
    "supervision": "image-variation",
    "refine": "on",
    "tick_stride": 1,
}
AS_GIVEN: dict[str, Any] = {"init": "sweep"}  # `natural` refuses dark recordings
PLAN = Arm("plan")
MOTION = Arm("motion", {"model": "linear"})
POSES = Arm("poses", {"init": "natural"})
IMAGES = Arm("images", {"images": "adaptive"})
INSTANTS = Arm("instants", {"tick_stride": 1})
SUPERVISION = Arm("supervision", {"supervision": "image-variation"})
GAUSSIANS_TWICE = Arm("Gaussians", {"gaussians": 2 * GAUSSIANS})
ALL_VIEWS = Arm("views", {"views": VIEWS})
GREY, COLOUR = Arm("grey", channels=1), Arm("colour", channels=3)
UNWATCHED = Arm("unwatched", {"model": "static"})  # the watch does not undo a model that was asked for


def _switched(*arms: Arm) -> dict[str, Arm]:
    return {arm.name: arm for arm in arms}


CASES = (
    Case("static", "static", 101, _switched(MOTION, SUPERVISION)),
    Case("mono", "fan_and_ball", 1, _switched(COLOUR)),
    Case("calibrated", "fan_and_ball", 2, _switched(POSES)),
    Case("few-movers", "stiff", 101, _switched(IMAGES, INSTANTS)),
    Case("dim", "dim", 101, _switched(MOTION), ticks=800, everything=AS_GIVEN),
    Case("one-dead-view", "fan_and_ball", 3, _switched(ALL_VIEWS), dead=DEAD, everything=AS_GIVEN | {"views": VIEWS}),
    Case("outdoors", "outdoor", 101, _switched(IMAGES, GAUSSIANS_TWICE)),
)
MISSED = Case("missed-mover", "faint", 101, {})
