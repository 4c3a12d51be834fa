"""The cases of the leave-out bench: recordings, the ways to run each, and a run that is to be made."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from reconstruction.bench.conventions import HOLDOUT, VIEWS
from reconstruction.run.configuration import ReconstructionConfig

TICKS = 200  # planes of a clip
TWICE = 96_000  # Gaussians, against the plan's 48,000
DEAD = "cam00"  # the camera without light


@dataclass(frozen=True)
class Arm:
    """One way to run a case: `choices` are fields of the configuration that differ from the default.

    `everywhere`: every pixel is taken to move. `channels`: number of the Gaussians' channels; where it is given, the
    training alone is measured, from the first snapshot of a run by the plan. `blind`: the plan took all for still.
    `even`: as many points are drawn from plain surfaces as from texture. `whole`: bodies are not cut into parts.
    """

    name: str
    choices: dict[str, Any] = field(default_factory=dict)
    everywhere: bool = False
    channels: int | None = None
    blind: bool = False
    even: bool = False
    whole: bool = False

    def config(self, *, steps: int | None = None, budget_s: float | None = None) -> ReconstructionConfig:
        """Return the configuration of a run of so many steps, or to a budget in seconds."""
        kind: dict[str, Any] = {"holdout": HOLDOUT} | self.choices
        return ReconstructionConfig(steps=steps, budget_s=budget_s, **kind)


@dataclass(frozen=True)
class PlanCase:
    """A recording of `ticks` planes; `switches` are the arms that decide otherwise, named by the decision.

    `dead`: a camera whose planes are empty. `devices`: how the simulated cameras differ from the plain ones.
    `otherwise`: choices of the arm `all` in place of those of SWITCHED.
    """

    name: str
    scene: str
    seed: int
    switches: tuple[Arm, ...] = ()
    ticks: int = TICKS
    dead: str | None = None
    devices: dict[str, Any] = field(default_factory=dict)
    otherwise: dict[str, Any] = field(default_factory=dict)

    @property
    def all(self) -> Arm:
        """The run that takes every choice otherwise than a plan does, and every pixel for one that moves."""
        return Arm("all", SWITCHED | self.otherwise, everywhere=True)


SWITCHED: dict[str, Any] = {
    "model": "linear",
    "init": "natural",
    "images": "adaptive",
    "supervision": "image-variation",
    "refine": "on",
    "gains": "on",
    "tick_stride": 1,
}
AS_GIVEN: dict[str, Any] = {"init": "sweep"}  # `natural` refuses dark recordings
PLAN = Arm("plan")
MOTION = Arm("motion", {"model": "linear"})
IMAGES = Arm("images", {"images": "adaptive"})
ALL_VIEWS = Arm("views", {"views": VIEWS})
GREY, COLOUR = Arm("grey", channels=1), Arm("colour", channels=3)
BLIND = Arm("blind", blind=True)
EVEN = Arm("plain surfaces", even=True)
WHOLE = Arm("bodies", whole=True)
UNWATCHED = Arm("unwatched", {"model": "static"})  # the watch does not undo a model that was asked for
UNLIKE: dict[str, Any] = {"camera_gains": 0.05, "camera_lags": 4.0}
CASES = (
    PlanCase("static", "static", 101, (MOTION, Arm("supervision", {"supervision": "image-variation"}))),
    PlanCase("at-rest", "static", 101, ticks=4000),
    PlanCase("mono", "fan_and_ball", 1, (COLOUR,)),
    PlanCase("calibrated", "fan_and_ball", 2, (Arm("poses", {"init": "natural"}), Arm("gains", {"gains": "on"}))),
    PlanCase("unlike-cameras", "fan_and_ball", 1, (Arm("gains", {"gains": "off"}),), devices=UNLIKE),
    PlanCase("few-movers", "stiff", 101, (IMAGES, Arm("instants", {"tick_stride": 1}))),
    PlanCase("dim", "dim", 101, (MOTION,), ticks=800, otherwise=AS_GIVEN),
    PlanCase("one-dead-view", "fan_and_ball", 3, (ALL_VIEWS,), dead=DEAD, otherwise=AS_GIVEN | {"views": VIEWS}),
    PlanCase("painted", "plain", 101, (EVEN,)),
    PlanCase("bending", "deforming", 101, (WHOLE,)),
    PlanCase("outdoors", "outdoor", 101, (IMAGES, Arm("Gaussians", {"gaussians": TWICE}))),
)
MISSED = PlanCase("missed-mover", "faint", 101)


@dataclass(frozen=True)
class Job:
    """A recording, an arm, the folder `out` that the run has to itself, and its length: `steps` or `budget_s`."""

    recording: Path
    arm: Arm
    out: Path
    steps: int | None = None
    budget_s: float | None = None
