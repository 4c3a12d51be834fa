"""What an operator may choose about a reconstruction."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

from reconstruction.errors import BadRunError

Model = Literal[
    "auto",
    "static",
    "linear",
    "cubic",
    "bases",
    "4dgs",
    "stg",
    "d3dgs",
    "spikegs",
    "dy-spikegs",
    "spikenerf",
    "dy-spikenerf",
]
Init = Literal["auto", "sweep", "natural", "sfm", "dust3r", "msdi"]
ImageSource = Literal[
    "auto",
    "tfi",
    "tfp",
    "tfstp",
    "tvs",
    "slope",
    "adaptive",
    "interpolated",
    "spk2imgnet",
    "blindspot",
    "msdi",
    "clean",
    "blurred",
]
Refine = Literal["auto", "on", "off"]
Supervision = Literal["auto", "pixels", "l1", "l2", "variation", "counts", "cumulative", "both"]

DEFAULT_BUDGET_S = 120.0
CHOICES = (
    ("model", Model),
    ("init", Init),
    ("images", ImageSource),
    ("supervision", Supervision),
    ("refine", Refine),
)


@dataclass(frozen=True)
class ReconstructionConfig:
    """Closed lists of names as the command line knows them; exactly one of `budget_s` and `steps` rules.

    `views`: training cameras by id (empty: all but the held-out one). `tick_stride`: planes between the instants whose
    images are targets. `gaussians`: the most there may be (None: as the plan says). `refine`: whether poses, gains and
    lags are learnt beside the Gaussians. Raises BadRunError naming the field. `dust3r_checkpoint`: the file with the
    user's weights, for the initialiser of that name.
    """

    model: Model = "auto"
    init: Init = "auto"
    images: ImageSource = "auto"
    supervision: Supervision = "auto"
    holdout: str | None = None
    views: tuple[str, ...] = ()
    budget_s: float | None = DEFAULT_BUDGET_S
    steps: int | None = None
    seed: int = 0
    gaussians: int | None = None
    tick_stride: int = 4
    refine: Refine = "auto"
    dust3r_checkpoint: str | None = None

    def __post_init__(self) -> None:
        for name, names in CHOICES:
            if getattr(self, name) not in get_args(names):
                raise BadRunError(f"found {name} {getattr(self, name)!r}", f"one of {', '.join(get_args(names))}")
        if (self.budget_s is None) == (self.steps is None):
            raise BadRunError("found both or neither of a budget in seconds and a number of steps", "one of them")
        if self.budget_s is not None and not self.budget_s > 0:
            raise BadRunError(f"found the budget {self.budget_s} s", "a positive number")
        if self.steps is not None and self.steps < 1:
            raise BadRunError(f"found {self.steps} steps", "at least 1")
        if self.gaussians is not None and self.gaussians < 1:
            raise BadRunError(f"found a cap of {self.gaussians} Gaussians", "at least 1")
        if self.tick_stride < 1:
            raise BadRunError(f"found a tick stride of {self.tick_stride}", "at least 1")
        if self.holdout is not None and self.holdout in self.views:
            raise BadRunError(
                f"found {self.holdout} both held out and among the training views", do="leave it out of one"
            )

    def to_json(self) -> dict:
        """Plain values, as kept in `run.json`."""
        return asdict(self) | {"views": list(self.views)}

    @classmethod
    def from_json(cls, document: dict) -> ReconstructionConfig:
        """The inverse of `to_json`."""
        values: dict[str, Any] = {**document, "views": tuple(document["views"])}
        return cls(**values)
