"""What the training bench runs: the whole engine at several budgets, and one choice changed at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION
from reconstruction.run.configuration import ReconstructionConfig

BUDGETS_S = (30.0, 60.0, 120.0)
SHORT_S, MIDDLE_S, _ = BUDGETS_S
HOLDOUT = "cam11"


@dataclass(frozen=True)
class Variant:
    """`choices` are the configuration's fields that differ from the default."""

    name: str
    about: str
    choices: dict[str, Any] = field(default_factory=dict)
    budgets_s: tuple[float, ...] = (MIDDLE_S,)
    scenes: tuple[str, ...] = EVALUATION

    def config(self, budget_s: float) -> ReconstructionConfig:
        """The configuration of one run."""
        return ReconstructionConfig(holdout=HOLDOUT, budget_s=budget_s, **self.choices)


AUTO = Variant("auto", "what the plan chooses", budgets_s=BUDGETS_S)
CLEAN = Variant("clean", "the same on the true images", {"images": "clean"}, BUDGETS_S[2:])
MODELS = (
    Variant("4dgs", "4DGS on TFI images", {"model": "4dgs", "images": "tfi"}),
    *(
        Variant(f"model.{name}", about, {"model": name}, (SHORT_S,), DEVELOPMENT)
        for name, about in (
            ("linear", "every mover on a straight path of its own"),
            ("cubic", "every mover on a cubic path of its own"),
            ("bases", "movers on rigid bodies, images alone: what the ablations change"),
        )
    ),
)
ABLATIONS = tuple(
    Variant(f"supervision.{name}", f"images and the spike term {name}", {"supervision": name}, (SHORT_S,), DEVELOPMENT)
    for name in ("l1", "l2", "image-variation", "counts", "cumulative")
)
VARIANTS = (AUTO, CLEAN, *MODELS, *ABLATIONS)
