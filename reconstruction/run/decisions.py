"""The plan of a run: what was decided, why, and what later stages amended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from reconstruction.images.methods.interpolated import PLANES
from reconstruction.methods.definition import SWEEPS
from reconstruction.run.configuration import EVEN, SWEPT, supervision_of
from reconstruction.run.spans import Span


@dataclass(frozen=True)
class Decision:
    """One choice: what it is about, what was chosen, why, and which option (such as `--model`, or "none") overrides it.

    `saves_s` (seconds of one thread) and `saves_bytes` are against what `reason` names; None: nothing, or not known.
    `facts`: numbers and names behind the reason, for programs.
    """

    about: str
    choice: str
    reason: str
    override: str
    saves_s: float | None = None
    saves_bytes: int | None = None
    facts: Mapping[str, float | int | str] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return one line for a person: `about: choice (saves 12 s, 40 MB): reason; override --x`."""
        saved = [] if self.saves_s is None else [f"{self.saves_s:.{0 if self.saves_s >= 10 else 1}f} s"]
        if self.saves_bytes is not None:
            saved.append(f"{self.saves_bytes / 1e6:.{0 if self.saves_bytes >= 1e7 else 1}f} MB")
        price = f" (saves {', '.join(saved)})" if saved else ""
        override = "" if self.override == "none" else f"; override {self.override}"
        return f"{self.about}: {self.choice}{price}: {self.reason}{override}"


@dataclass(frozen=True)
class Plan:
    """A plan in numbers and names: what the stages of a run will do.

    `views`: ids of the training cameras. `model`, `images`, `supervision`, `init`, `points`: names, none of them
    `auto`. `refine`: whether poses, gains and lags are learnt in training. `pixels`: what is taken of single pixels.
    A scene has at most `still_gaussians` and, in each span, `moving_gaussians`. `window`: planes of a short image, an
    odd number. `doublings`: shares of the training at which pictures double in width and height, in order.
    `spans`: the planes [first, last) of each span of a recording that is reconstructed in spans; empty for one in a
    piece. `sweeps`: instants at which movers are swept.
    """

    views: tuple[str, ...]
    model: str
    images: str
    supervision: str
    moving_gaussians: int
    still_gaussians: int
    decisions: tuple[Decision, ...]
    init: str = "sweep"
    points: str = SWEPT
    refine: bool = False
    pixels: str = EVEN
    window: int = PLANES
    doublings: tuple[float, ...] = ()
    spans: tuple[Span, ...] = ()
    sweeps: int = SWEEPS

    def amended(self, amendment: Amendment) -> Plan:
        """Return the plan with the amendment's decision in place of the one about the same thing, and its changes."""
        kept = tuple(d for d in self.decisions if d.about != amendment.decision.about)
        changes: dict[str, Any] = dict(amendment.changes)
        return replace(self, decisions=(*kept, amendment.decision), **changes)

    @classmethod
    def from_json(cls, document: dict) -> Plan:
        """Return the plan that `dataclasses.asdict` made plain; what an earlier revision had beyond is passed over."""
        supervision = supervision_of(document, "spans")
        known: dict[str, Any] = {f.name: document[f.name] for f in fields(cls) if f.name in document}
        known |= {"views": tuple(document["views"]), "supervision": supervision}
        known |= {"doublings": tuple(document.get("doublings", ()))}
        known |= {"spans": tuple(Span(**span) for span in document.get("spans", ()))}
        known["decisions"] = tuple(Decision(**d) for d in document["decisions"])
        return cls(**known)


@dataclass(frozen=True)
class Amendment:
    """A change of the plan by a later stage that had seen more: one decision, and fields of the plan."""

    stage: str
    decision: Decision
    changes: Mapping[str, str | bool | int] = field(default_factory=dict)

    @classmethod
    def from_json(cls, document: dict) -> Amendment:
        """Return the amendment that `dataclasses.asdict` made plain."""
        return cls(document["stage"], Decision(**document["decision"]), document["changes"])
