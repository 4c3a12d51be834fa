"""The plan of a run: what was decided, why, and what later stages amended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

from reconstruction.run.configuration import RENAMED

Override = str  # an option such as `--model`; "none" where no option overrides a decision


@dataclass(frozen=True)
class Decision:
    """One choice: what it is about, what was chosen, why, and which option overrides it.

    `saves_s` (seconds of one thread) and `saves_bytes` are against what `reason` names; None: nothing, or not known.
    `facts`: numbers and names behind the reason, for programs.
    """

    about: str
    choice: str
    reason: str
    override: Override
    saves_s: float | None = None
    saves_bytes: int | None = None
    facts: Mapping[str, float | int | str] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return one line for a person: `about: choice (saves 12 s, 40 MB): reason; override --x`."""
        saved = spoken(self.saves_s, self.saves_bytes)
        price = f" ({saved})" if saved else ""
        override = "" if self.override == "none" else f"; override {self.override}"
        return f"{self.about}: {self.choice}{price}: {self.reason}{override}"


@dataclass(frozen=True)
class Plan:
    """A plan in numbers and names: what the stages of a run will do.

    `views`: ids of the training cameras. `model`, `images`, `supervision`, `init`: names, none of them `auto`.
    `refine`: whether poses, gains and lags are learnt in training. The most Gaussians there may be are split into
    `still_gaussians` and `moving_gaussians`.
    """

    views: tuple[str, ...]
    model: str
    images: str
    supervision: str
    moving_gaussians: int
    still_gaussians: int
    decisions: tuple[Decision, ...]
    init: str = "sweep"
    refine: bool = False

    def decision(self, about: str) -> Decision | None:
        """Return the decision about something; None where there is none."""
        return next((d for d in self.decisions if d.about == about), None)

    def amended(self, amendment: Amendment) -> Plan:
        """Return the plan with the amendment's decision in place of the one about the same thing, and its changes."""
        kept = tuple(d for d in self.decisions if d.about != amendment.decision.about)
        changes: dict[str, Any] = dict(amendment.changes)
        return replace(self, decisions=(*kept, amendment.decision), **changes)

    def to_json(self) -> dict:
        """Return plain values, as kept in `run.json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: dict) -> Plan:
        """Return the plan that `to_json` wrote; what an earlier revision said beyond that is passed over."""
        supervision = RENAMED.get(document["supervision"], document["supervision"])
        known: dict[str, Any] = {f.name: document[f.name] for f in fields(cls) if f.name in document}
        known |= {"views": tuple(document["views"]), "supervision": supervision}
        known["decisions"] = tuple(Decision(**d) for d in document["decisions"])
        return cls(**known)


@dataclass(frozen=True)
class Amendment:
    """A change of the plan by a later stage that had seen more: one decision, and fields of the plan."""

    stage: Literal["poses", "train"]
    decision: Decision
    changes: Mapping[str, str | bool] = field(default_factory=dict)

    @classmethod
    def from_json(cls, document: dict) -> Amendment:
        """Return the amendment that `dataclasses.asdict` made plain."""
        return cls(document["stage"], Decision(**document["decision"]), document["changes"])


def spoken(saves_s: float | None, saves_bytes: int | None) -> str:
    """Return `saves 12 s, 40 MB`, or nothing where neither is known."""
    parts = [] if saves_s is None else [f"{saves_s:.0f} s" if saves_s >= 10 else f"{saves_s:.1f} s"]
    if saves_bytes is not None:
        parts.append(f"{saves_bytes / 1e6:.0f} MB" if saves_bytes >= 1e7 else f"{saves_bytes / 1e6:.1f} MB")
    return f"saves {', '.join(parts)}" if parts else ""
