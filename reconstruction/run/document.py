"""The content of `run.json`: how far a run is, what was asked for and decided, and the results."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal

from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.decisions import Amendment, Plan

SCHEMA = 1
UNITS = ("gaussians", "cells")  # what models are made of


@dataclass(frozen=True)
class Elements:
    """The number of elements of a trained model, and their unit: one of UNITS."""

    unit: str
    still: int
    moving: int

    @property
    def total(self) -> int:
        """All of them."""
        return self.still + self.moving


@dataclass(frozen=True)
class BodyCounts:
    """The numbers of rigid bodies, of points attached to them, and of free points by reason."""

    rigid: int
    attached: int
    free: Mapping[str, int]


@dataclass(frozen=True)
class EarlyEnd:
    """The step at which a training ended before its budget, and why."""

    step: int
    reason: str


@dataclass
class RunDocument:
    """The content of `run.json`; what has not come yet is None.

    `planned`: the plan as the plan stage made it, which nothing changes; `amendments`: what later stages changed in it,
    in their order. `poses`, `refinement`: the reports of the poses stage and of the refinement in training. `seconds`
    by finished stage. `attempt`: how often stages were forgotten to be run again. `held_out_used`: whether the spikes
    of the held-out camera were read before the report; None in a run of an earlier revision, where `poses` says it.
    `warnings` by stage: what a person should know before trusting the result.
    """

    recording: str
    configuration: ReconstructionConfig
    revision: str = ""
    backend: str = "native"
    status: Literal["unfinished", "finished"] = "unfinished"
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: dict[str, str] = field(default_factory=dict)
    attempt: int = 0
    held_out_used: bool | None = False
    planned: Plan | None = None
    amendments: list[Amendment] = field(default_factory=list)
    poses: Mapping[str, object] | None = None
    bodies: BodyCounts | None = None
    steps: int | None = None
    elements: Elements | None = None
    stopped_early: EarlyEnd | None = None
    refinement: Mapping[str, Mapping[str, float]] | None = None

    @property
    def plan(self) -> Plan | None:
        """The plan with all amendments made."""
        plan = self.planned
        for amendment in self.amendments:
            plan = plan and plan.amended(amendment)
        return plan

    def undo_amendments(self, stages: Collection[str]) -> None:
        """Take out of the plan what these stages have changed in it."""
        self.amendments = [amendment for amendment in self.amendments if amendment.stage not in stages]

    def to_json(self) -> dict[str, Any]:
        """Return plain values; `plan` is the amended one, beside `planned` and `amendments`, which make it."""
        plain = {key: value for key, value in asdict(self).items() if value is not None}
        if self.elements is not None:
            plain[self.elements.unit] = {key: n for key, n in plain.pop("elements").items() if key != "unit"}
        if self.plan is not None:
            plain["plan"] = asdict(self.plan)
        return {"schema": SCHEMA, "seed": self.configuration.seed, "held_out_used": self.held_out_used, **plain}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> RunDocument:
        """Return the document that `to_json` wrote, also one of an earlier revision, without `planned`."""
        known = {f.name: plain[f.name] for f in fields(cls) if f.name in plain}
        known["configuration"] = ReconstructionConfig.from_json(plain["configuration"])
        known["held_out_used"] = plain.get("held_out_used")
        known["amendments"] = [Amendment.from_json(a) for a in plain.get("amendments", ())]
        planned = plain.get("planned", plain.get("plan"))
        known["planned"] = Plan.from_json(planned) if planned else None
        for name, kind in (("bodies", BodyCounts), ("stopped_early", EarlyEnd)):
            if name in plain:
                known[name] = kind(**plain[name])
        for unit in UNITS:
            if unit in plain:
                known["elements"] = Elements(unit, **plain[unit])
        return cls(**known)
