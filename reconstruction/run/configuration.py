"""The choices that an operator has about a reconstruction; importing them loads no torch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.images import catalogue as image_catalogue
from reconstruction.initialization.initialisers import INITIALISERS
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.definition import AS_KIND, RateFactors
from reconstruction.run.spans import LEAST
from reconstruction.training.term import supervisions

DEFAULT_BUDGET_S = 120.0
STAGES = ("plan", "poses", "images", "points", "train", "report")
FOLLOW = "follow"  # before the first stage, where the recording is still written: looks at its newest planes
SUPERVISIONS = supervisions()
MAPS, EVEN = "maps", "even"  # what is taken of single pixels: what a calibration found, or that all are alike
PIXELS = (MAPS, EVEN)
SWEPT, FOUND, RANDOM = "swept", "found", "random"  # points: of our plane sweep, of the initialiser, at random depths
POINTS = (SWEPT, FOUND, RANDOM)
SEEDS = 2**31  # all that OpenCV takes
CUDA = "cuda"  # the device on which gsplat renders; nothing ever ran on one, so that auto is the processor
CHOICES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "model": ("auto", *METHODS),
        "init": ("auto", *INITIALISERS),
        "points": ("auto", *POINTS),
        "images": ("auto", *image_catalogue.sources()),
        "supervision": ("auto", *SUPERVISIONS),
        "refine": ("auto", "on", "off"),
        "pixels": ("auto", *PIXELS),
        "gains": ("auto", "on", "off"),
        "device": ("auto", "cpu", CUDA),
    }
)


class Results(NamedTuple):
    """The results of a stage that another attempt may not write again: `files`, and what is `told` in `run.json`."""

    files: tuple[str, ...] = ()
    told: tuple[str, ...] = ()


RESULTS: Mapping[str, Results] = {  # by stage
    "poses": Results(("poses/rig.toml", "poses/points_*.npy"), ("poses",)),
    "points": Results(("points/gains.npy", "points/empty_*.npy", "points/bodies_*.npy"), ("bodies",)),
    "train": Results(("poses/refined.toml", "evidence.pt"), ("steps", "elements", "stopped_early", "refinement")),
    "report": Results(("poses/held_out.toml",)),
}


@dataclass(frozen=True)
class ReconstructionConfig:
    """The choices for one run, each from its closed list in CHOICES; exactly one of `budget_s` and `steps` rules.

    `views`: training cameras by id (empty: all but the held-out one). `tick_stride`: planes between the instants whose
    images are targets. `gaussians`: the most there may be (None: as the plan says). `refine`: whether poses, gains and
    lags are learnt beside the Gaussians. `pixels`: what is taken of single pixels. `gains`: whether each camera has a
    gain and a lag of its own. `points`: those that training starts from. `dust3r_checkpoint`: the file with the user's
    weights, for the initialiser of that name. `window`: planes of the short images of movers (None: as the plan says).
    `span`: most planes of a span of a long recording (None: as the plan says). `from_tick`, `to_tick`: the ticks [from,
    to) that are reconstructed (None: from the first, to the last). `device`: where the training is done; all other
    stages take the processor. Two are for searches: `rates`, factors of the method's learning rates, and
    `spike_weight`, the weight of a loss on spikes in steps that compare an image, too (None: such steps have it alone).
    Raises BadRunError naming the field.
    """

    model: str = "auto"
    init: str = "auto"
    points: str = "auto"
    images: str = "auto"
    supervision: str = "auto"
    holdout: str | None = None
    views: tuple[str, ...] = ()
    budget_s: float | None = DEFAULT_BUDGET_S
    steps: int | None = None
    seed: int = 0
    gaussians: int | None = None
    tick_stride: int = 4
    refine: str = "auto"
    pixels: str = "auto"
    gains: str = "auto"
    dust3r_checkpoint: str | None = None
    window: int | None = None
    span: int | None = None
    from_tick: int | None = None
    to_tick: int | None = None
    device: str = "auto"
    rates: RateFactors = AS_KIND
    spike_weight: float | None = None

    def __post_init__(self) -> None:
        for name, names in CHOICES.items():
            if getattr(self, name) not in names:
                raise BadRunError(f"found {name} {getattr(self, name)!r}", f"one of {', '.join(names)}")
        if self.device == CUDA and self.model != "auto" and METHODS[self.model].rays:
            found, do = f"found --device {CUDA} with --model {self.model}", "take --device cpu"
            raise BadRunError(found, "a model of Gaussians: rays are marched on the processor alone", do)
        if (self.budget_s is None) == (self.steps is None):
            raise BadRunError("found both or neither of a budget in seconds and a number of steps", "one of them")
        if self.budget_s is not None and not 0 < self.budget_s < math.inf:
            raise BadRunError(f"found the budget {self.budget_s} s", "a positive number")
        if self.steps is not None and self.steps < 1:
            raise BadRunError(f"found {self.steps} steps", "at least 1")
        if not 0 <= self.seed < SEEDS:
            raise BadRunError(f"found the seed {self.seed}", f"one of 0 to {SEEDS - 1}")
        if self.gaussians is not None and self.gaussians < 1:
            raise BadRunError(f"found a cap of {self.gaussians} Gaussians", "at least 1")
        if not all(0 < factor < math.inf for factor in self.rates):
            raise BadRunError(f"found the factors of rates {self.rates}", "positive numbers")
        if self.spike_weight is not None and not 0 <= self.spike_weight < math.inf:
            raise BadRunError(f"found the weight {self.spike_weight} of a loss on spikes", "a number from 0")
        if self.tick_stride < 1:
            raise BadRunError(f"found a tick stride of {self.tick_stride}", "at least 1")
        if self.window is not None and (self.window < 1 or self.window % 2 == 0):
            raise BadRunError(f"found a window of {self.window} planes", "an odd number from 1")
        if self.span is not None and self.span < LEAST:
            raise BadRunError(f"found a span of {self.span} planes", f"at least {LEAST}, in which movers can be told")
        if self.from_tick is not None and self.to_tick is not None and self.from_tick >= self.to_tick:
            found = f"found the ticks {self.from_tick} to {self.to_tick}"
            raise BadRunError(found, "at least one", "change --from-tick or --to-tick")
        if len(set(self.views)) < len(self.views):
            raise BadRunError(f"found the views {', '.join(self.views)}", "each camera once", "change --views")
        if self.holdout is not None and self.holdout in self.views:
            raise BadRunError(
                f"found {self.holdout} both held out and among the training views", do="leave it out of one"
            )

    def part_of(self, recording: Recording) -> Recording:
        """Return the ticks of a recording that are reconstructed: all cameras in use have all of them."""
        used = (*self.views, self.holdout) if self.views else ()
        return recording.part(self.from_tick, self.to_tick, [c for c in recording.camera_ids if c in used])

    @classmethod
    def from_json(cls, document: dict) -> ReconstructionConfig:
        """Return the configuration that `dataclasses.asdict` made plain, also one of an earlier revision."""
        supervision = supervision_of(document, "device")
        values: dict[str, Any] = {**document, "supervision": supervision, "views": tuple(document["views"])}
        if "rates" in values:
            values["rates"] = RateFactors(*values["rates"])
        return cls(**values)


def supervision_of(document: dict, since: str) -> str:
    """Return the supervision that a document names; one without the key `since` is of a revision before it.

    There `variation` was what is `image-variation` now.
    """
    named = document["supervision"]
    return "image-variation" if named == "variation" and since not in document else named
