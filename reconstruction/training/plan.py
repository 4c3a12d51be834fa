"""Looks at the spikes once and decides what this scene needs; everything left out is listed with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.light import Light, estimate_light
from reconstruction.images.motion import moving_pixels
from reconstruction.training.config import ReconstructionConfig
from rigs.rig import Rig

DARK_RATE = 1e-4  # spikes per pixel and tick; below it a view carries no picture
STILL_SHARE = 5e-4  # share of moving pixels below which the scene is static
LEAST_VIEWS = 2
LIGHT_VIEWS = 4  # enough to see the light of the whole scene


@dataclass(frozen=True)
class Decision:
    """One choice: what it is about, what was chosen, why, and which option overrides it."""

    about: str
    choice: str
    reason: str
    override: str


@dataclass(frozen=True)
class Plan:
    """`views` train; `model`, `images`, `supervision` are concrete; the cap splits into still and moving Gaussians."""

    views: tuple[str, ...]
    model: str
    images: str
    supervision: str
    moving_gaussians: int
    still_gaussians: int
    decisions: tuple[Decision, ...]

    def amended(self, decision: Decision, **changes: object) -> Plan:
        """The plan after a later stage has seen more: `decision` in place of the one about the same thing."""
        kept = tuple(d for d in self.decisions if d.about != decision.about)
        return replace(self, decisions=(*kept, decision), **changes)

    def to_json(self) -> dict:
        """Plain values, as kept in `run.json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: dict) -> Plan:
        """The inverse of `to_json`."""
        decisions = tuple(Decision(**d) for d in document["decisions"])
        return cls(**(document | {"views": tuple(document["views"]), "decisions": decisions}))


def make_plan(
    config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream]
) -> tuple[Plan, dict[str, NDArray[np.bool_]], Light]:
    """The plan, each training view's mask of moving pixels [H, W], the light; reads no stream but the training ones."""
    decisions: list[Decision] = []
    views = _training_views(config, rig, streams, decisions)
    light = _light([streams[view] for view in views], decisions)
    masks = {view: moving_pixels(streams[view], light) for view in views}
    model = _choose_model(config, masks, decisions)
    if model == "static":
        masks = {view: np.zeros_like(mask) for view, mask in masks.items()}
    images = config.images if config.images != "auto" else "interpolated"
    if config.images == "auto":
        decisions.append(
            Decision(
                "images",
                images,
                "long mean where nothing moves, 9-plane interpolated count where something does",
                "--images",
            )
        )
    supervision = config.supervision
    if supervision == "auto":
        supervision = "pixels"
        reason = "at equal time no spike term gained on the development scenes"
        decisions.append(Decision("supervision", supervision, reason, "--supervision"))
    decisions.append(Decision("poses", "not estimated", f"the rig's poses are {rig.poses} and used as given", "--init"))
    decisions.append(Decision("colour", "one grey channel, no view dependence", "a spike carries no colour", "none"))
    still, moving = _split(config.gaussians, model, masks)
    return Plan(views, model, images, supervision, moving, still, tuple(decisions)), masks, light


def _training_views(
    config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream], decisions: list[Decision]
) -> tuple[str, ...]:
    if config.holdout is not None:
        rig.camera(config.holdout)
    asked = config.views or tuple(c for c in rig.ids if c != config.holdout)
    for view in asked:
        rig.camera(view)
    lit = []
    for view in asked:
        stream = streams[view]
        rate = stream.counts(0, len(stream)).mean() / len(stream)
        if rate < DARK_RATE:
            decisions.append(Decision("views", f"{view} skipped", f"{rate:.1e} spikes per tick: no light", "--views"))
        else:
            lit.append(view)
    if len(lit) < LEAST_VIEWS:
        raise BadRunError(
            f"found {len(lit)} training views with light, expected {LEAST_VIEWS} or more; record again or name others"
        )
    return tuple(lit)


def _light(streams: Sequence[SpikeStream], decisions: list[Decision]) -> Light:
    light = estimate_light(streams[:LIGHT_VIEWS])
    if light.flickers:
        least, most = light.gains.min(), light.gains.max()
        reason = f"still pixels see {least:.2f} to {most:.2f} of the mean light"
        decisions.append(Decision("light", "one gain a plane", reason, "none"))
    else:
        decisions.append(Decision("light", "steady: no gains", "still pixels see no flicker", "none"))
    return light


def _choose_model(
    config: ReconstructionConfig, masks: Mapping[str, NDArray[np.bool_]], decisions: list[Decision]
) -> str:
    if config.model != "auto":
        return config.model
    share = float(np.mean([mask.mean() for mask in masks.values()]))
    if share < STILL_SHARE:
        decisions.append(Decision("motion", "static", f"{share:.2%} of the pixels change: no motion model", "--model"))
        return "static"
    reason = f"{share:.1%} of the pixels change; straight paths instead where bodies explain the counts no better"
    decisions.append(Decision("motion", "bases", reason, "--model"))
    return "bases"


def _split(cap: int, model: str, masks: Mapping[str, NDArray[np.bool_]]) -> tuple[int, int]:
    """Still and moving Gaussians of the cap: movers get more than their share, the more where each is seen for a while.

    What rides on a body is seen all along: with half as many, `fan_and_ball` gained 0.5 dB over the whole view and lost
    as much on movers.
    """
    if model == "static":
        return cap, 0
    share = float(np.mean([mask.mean() for mask in masks.values()]))
    moving = round(cap * min(0.6, max(0.1, (1.25 if model == "bases" else 2.5) * share)))
    return cap - moving, moving
