"""Looks at the spikes once and decides what this scene needs; everything left out is listed with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.flicker import Light, estimate_light
from reconstruction.images.moving_pixels import moving_pixels
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.definition import Method
from reconstruction.methods.ours import BASES
from reconstruction.run.configuration import RENAMED, ReconstructionConfig
from reconstruction.run.prices import FLOAT_BYTES, KEPT_COPIES, Work, spoken
from rigs.rig import Rig

DARK_RATE = 1e-4  # spikes per pixel and tick; below it a view carries no picture
STILL_SHARE = 5e-4  # share of moving pixels below which the scene is static
LEAST_VIEWS = 2
TWIN_PLANES = 32  # at the start of two streams that tell whether they are one
LIGHT_VIEWS = 4  # enough to see the light of the whole scene
INSTANTS = 8  # at which movers are swept
A_PIXEL = 2  # Gaussians at most for each pixel of a view
GAUSSIAN_FLOATS = 12  # of a still one
UNADJUSTED = ("sfm", "dust3r")  # poses that no covariance vouches for are refined in training
BEST_METHOD = "adaptive"  # of those without a network, on single images


@dataclass(frozen=True)
class Decision:
    """One choice: what it is about, what was chosen, why, which option overrides it, and what it saves.

    `saves_s` (seconds of one thread) and `saves_bytes` are against what `reason` names; None: nothing, or not known.
    """

    about: str
    choice: str
    reason: str
    override: str
    saves_s: float | None = None
    saves_bytes: int | None = None

    def __str__(self) -> str:
        """One line for a person: `about: choice (saves 12 s, 40 MB): reason; override --x`."""
        saved = spoken(self.saves_s, self.saves_bytes)
        price = f" ({saved})" if saved else ""
        override = "" if self.override == "none" else f"; override {self.override}"
        return f"{self.about}: {self.choice}{price}: {self.reason}{override}"


@dataclass(frozen=True)
class Plan:
    """`views` train; `model` to `init` are concrete; the cap splits into still and moving Gaussians."""

    views: tuple[str, ...]
    model: str
    images: str
    supervision: str
    moving_gaussians: int
    still_gaussians: int
    decisions: tuple[Decision, ...]
    init: str = "sweep"
    refine: bool = False

    def amended(self, decision: Decision, **changes: object) -> Plan:
        """The plan after a later stage has seen more: `decision` in place of the one about the same thing."""
        kept = tuple(d for d in self.decisions if d.about != decision.about)
        return replace(self, decisions=(*kept, decision), **changes)

    def to_json(self) -> dict:
        """Plain values, as kept in `run.json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: dict) -> Plan:
        """The inverse of `to_json`; what an earlier revision said beyond that is passed over."""
        decisions = tuple(Decision(**d) for d in document["decisions"])
        known = {f.name: document[f.name] for f in fields(cls) if f.name in document}
        supervision = RENAMED.get(document["supervision"], document["supervision"])
        views = tuple(document["views"])
        return cls(**(known | {"views": views, "decisions": decisions, "supervision": supervision}))


def make_plan(
    config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream]
) -> tuple[Plan, dict[str, NDArray[np.bool_]], Light]:
    """The plan, each training view's mask of moving pixels [H, W], the light; reads no stream but the training ones."""
    decisions: list[Decision] = []
    views = _training_views(config, rig, streams, decisions)
    light = _light([streams[view] for view in views], decisions)
    masks = {view: moving_pixels(streams[view], light) for view in views}
    work = _work(config, rig, streams, views)
    model = _choose_model(config, masks, work, decisions)
    method = METHODS[model]
    work = replace(work, gaussians=config.gaussians or min(method.gaussians, A_PIXEL * work.pixels))
    _refuse_for_rays(config, method)
    if not method.moves:
        masks = {view: np.zeros_like(mask) for view, mask in masks.items()}
    images, supervision = _choose_targets(config, work, _share(masks), method, decisions)
    still, moving = _split(work.gaussians, method, masks)
    decisions += _economies(config, work, _share(masks), (still, moving))
    decisions += _left_out(rig, views, work)
    init = _choose_init(config, rig, work, decisions)
    refine = config.refine == "on" or (config.refine == "auto" and init in UNADJUSTED and not method.rays)
    return Plan(views, model, images, supervision, moving, still, tuple(decisions), init, refine), masks, light


def _refuse_for_rays(config: ReconstructionConfig, method: Method) -> None:
    """A radiance field learns from the spikes of single rays, whose cameras stand as they are."""
    if method.rays and config.refine == "on":
        raise BadRunError(f"found --refine on with --model {method.name}, which cannot refine poses", do="leave it out")
    if method.rays and config.supervision != "auto":
        raise BadRunError(
            f"found --supervision {config.supervision} with --model {method.name}, which learns from single rays",
            do="leave it out",
        )


def _work(config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream], views: Sequence[str]) -> Work:
    camera, planes = rig.camera(views[0]), min(len(streams[view]) for view in views)
    size = camera.width * camera.height
    return Work(size, planes, len(views), config.gaussians or 0, config.budget_s, config.steps)


def _share(masks: Mapping[str, NDArray[np.bool_]]) -> float:
    """The share of all pixels that move."""
    return float(np.mean([mask.mean() for mask in masks.values()]))


def _choose_targets(
    config: ReconstructionConfig, work: Work, share: float, method: Method, decisions: list[Decision]
) -> tuple[str, str]:
    """The image method and the supervision."""
    images, supervision = config.images, config.supervision
    if images == "auto":
        images, count = "interpolated", work.images(config.tick_stride)
        gap_s = work.image_s(BEST_METHOD) - work.image_s(images)
        reason = f"long mean where nothing moves, 9-plane interpolated count where something does, not {BEST_METHOD}"
        decisions.append(Decision("images", images, reason, "--images", count * gap_s if share else None))
    if supervision == "auto" and method.supervision != "pixels":
        supervision = method.supervision
        decisions.append(Decision("supervision", supervision, f"as {method.name} is published", "--supervision"))
    elif supervision == "auto":
        supervision = "pixels"
        reason = "at equal time no spike term gained on the development scenes; one renders three instants a step"
        decisions.append(Decision("supervision", supervision, reason, "--supervision", work.instants_s()))
    return images, supervision


def _economies(config: ReconstructionConfig, work: Work, share: float, counts: tuple[int, int]) -> list[Decision]:
    """Instants and Gaussians: what is kept small from the start."""
    stride, (still, moving) = config.tick_stride, counts
    fewer = work.images(1) - work.images(stride)
    kept = round(fewer * work.pixels * share) * FLOAT_BYTES
    image_s = work.image_s(config.images if config.images != "auto" else "interpolated")
    spared = (fewer * image_s, kept) if fewer and share else (None, None)
    reason = f"{work.images(stride)} target images are drawn again and again, not {work.images(1)} for every plane"
    every = f"an image every {stride} planes"
    splats = f"{still:,} still and {moving:,} moving"
    cost = (work.splats_s(work.gaussians), GAUSSIAN_FLOATS * FLOAT_BYTES * KEPT_COPIES * work.gaussians)
    return [
        Decision("instants", every, reason, "--tick-stride", *spared),
        Decision("Gaussians", splats, "against twice as many", "none", *cost),
    ]


def _left_out(rig: Rig, views: Sequence[str], work: Work) -> list[Decision]:
    """What no reconstruction does."""
    calibrated = sum(rig.camera(view).pixels is not None for view in views)
    if calibrated:
        maps = f"maps of {calibrated} views are there, but training does not read them"
    else:
        maps = "the recording has no maps; `spike4dgs calibrate --pixels` makes them"
    grey = "a spike carries no colour; against three channels of third-degree harmonics"
    return [
        Decision("pixels", "taken as even", maps, "none"),
        Decision("colour", "one grey channel, no view dependence", grey, "none", None, work.colour_bytes()),
    ]


def _choose_init(config: ReconstructionConfig, rig: Rig, work: Work, decisions: list[Decision]) -> str:
    """How the cameras are found; the stage that does it says what came of it."""
    if config.init != "auto":
        return config.init
    init = "natural" if rig.poses == "nominal" else "sweep"
    choice = "found by natural" if init == "natural" else "not estimated"
    spared_s = None if init == "natural" else work.poses_s()
    decisions.append(Decision("poses", choice, f"the rig's poses are {rig.poses}", "--init", spared_s))
    return init


def _training_views(
    config: ReconstructionConfig, rig: Rig, streams: Mapping[str, SpikeStream], decisions: list[Decision]
) -> tuple[str, ...]:
    if config.holdout is not None:
        rig.camera(config.holdout)
    asked = config.views or tuple(c for c in rig.ids if c != config.holdout)
    for view in asked:
        rig.camera(view)
    _refuse_twins(asked, streams)
    lit = []
    for view in asked:
        stream = streams[view]
        rate = stream.counts(0, len(stream)).mean() / len(stream)
        if rate < DARK_RATE and view not in config.views:
            reason, spared_s = (
                f"{rate:.1e} spikes per tick: no light",
                _work(config, rig, streams, [view]).view_s(INSTANTS),
            )
            decisions.append(Decision("views", f"{view} skipped", reason, "--views", spared_s))
        else:
            lit.append(view)
    if len(lit) < LEAST_VIEWS:
        raise BadRunError(
            f"found {len(lit)} training views with light", f"{LEAST_VIEWS} or more", "record again or name others"
        )
    return tuple(lit)


def _refuse_twins(views: Sequence[str], streams: Mapping[str, SpikeStream]) -> None:
    """Two cameras never fire alike: the same planes that are not silent are one file under two names."""
    seen: dict[bytes, str] = {}
    for view in views:
        planes = streams[view].window(0, min(TWIN_PLANES, len(streams[view])))
        if not planes.any():
            continue
        twin = seen.setdefault(planes.tobytes(), view)
        if twin != view:
            raise BadRunError(f"found the same spikes in {twin} and {view}", "one stream a camera", "import again")


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
    config: ReconstructionConfig, masks: Mapping[str, NDArray[np.bool_]], work: Work, decisions: list[Decision]
) -> str:
    if config.model != "auto":
        return config.model
    share = _share(masks)
    if share < STILL_SHARE:
        reason = f"{share:.2%} of the pixels change: no motion model"
        decisions.append(Decision("motion", "static", reason, "--model", work.movers_s(INSTANTS)))
        return "static"
    reason = f"{share:.1%} of the pixels change; straight paths instead where bodies explain the counts no better"
    decisions.append(Decision("motion", "bases", reason, "--model"))
    return "bases"


def _split(cap: int, method: Method, masks: Mapping[str, NDArray[np.bool_]]) -> tuple[int, int]:
    """Still and moving Gaussians of the cap: movers get more than their share, the more where each is seen for a while.

    What rides on a body is seen all along: with half as many, `fan_and_ball` gained 0.5 dB over the whole view and lost
    as much on movers.
    """
    if not method.moves:
        return cap, 0
    moving = round(cap * min(0.6, max(0.1, (1.25 if method is BASES else 2.5) * _share(masks))))
    return cap - moving, moving
