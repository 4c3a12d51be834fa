"""A scene of any length: still Gaussians once, and what differs from them in spans of the recording.

Letters: N still Gaussians of the whole recording, C of them that a span shows otherwise, M movers of a span.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from torch import Tensor

from reconstruction.errors import ReconstructionError
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import UNSAID_PX2, DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.gaussians.stored import restored, stored
from reconstruction.rendering.result import GUARDS, Instantaneous
from reconstruction.scene_model import Rate, TimeSpan, View, gain_at
from rigs.camera import Camera

OWN = ("opacity_logits", "intensities")  # of a still Gaussian, what a span may change: its presence and its light
LEARNT = tuple(f"still.{kind}" for kind in OWN)


@dataclass
class SpanCloud(DynamicCloud):
    """The scene of one span while it is learnt: `common` Gaussians, which are given, before what is its own.

    `still` are the C Gaussians that the span may show otherwise than the recording; only OWN of them is learnt.
    """

    common: GaussianCloud = field(default_factory=lambda: nothing())

    def __len__(self) -> int:
        return len(self.common) + super().__len__()

    @property
    def given(self) -> int:
        """The number of leading Gaussians of `at` that nothing is learnt of."""
        return len(self.common)

    def at(self, instant_s: float) -> Instantaneous:
        """Return all Gaussians at one instant of the rig clock; differentiable in what is learnt."""
        pairs = zip(self._given_at(instant_s), super().at(instant_s), strict=True)
        return Instantaneous(*(torch.cat(pair) for pair in pairs))

    def _given_at(self, instant_s: float) -> Instantaneous:
        given, light = self.common, self.common.intensities
        if len(self.light) > 1:
            light = light * gain_at(self.light, self.clip.fraction(instant_s))
        return Instantaneous(given.means, given.quats_wxyz, given.log_scales, given.opacity_logits.sigmoid(), light)

    def rates(self) -> Mapping[str, Rate]:
        """Return the learning rate of every tensor that is learnt, by name."""
        rates = super().rates()
        return {name: rate for name, rate in rates.items() if not name.startswith("still.") or name in LEARNT}

    def to(self, kind: torch.dtype | torch.device) -> SpanCloud:
        """Refuse: spans are learnt in float32 on the processor."""
        raise ReconstructionError(f"found a span, wanted as {kind}", "float32 on the processor")

    def opacity(self) -> Tensor:
        """Return the largest share of the light that each Gaussian takes, [N + M] in 0 to 1, without gradients."""
        return torch.cat([self.common.opacity_logits.detach().sigmoid(), super().opacity()])


@dataclass
class SpanContent:
    """The own content of one span of a recording: movers, and C still Gaussians that it shows otherwise.

    `clip`: the span on the rig clock. `changed` [C] int64: which of the still ones; `opacity_logits` [C] and
    `intensities` [C, 1] are those that they have here. `cloud`: the movers alone, in their own clip, which may reach
    over the ends of the span; None where nothing moves.
    """

    clip: TimeSpan
    changed: Tensor
    opacity_logits: Tensor
    intensities: Tensor
    cloud: DynamicCloud | None = None

    @classmethod
    def as_usual(cls, clip: TimeSpan) -> SpanContent:
        """Return the content of a span that shows nothing but the still scene."""
        return cls(clip, torch.zeros(0, dtype=torch.int64), torch.zeros(0), torch.zeros(0, 1))

    @classmethod
    def of(cls, clip: TimeSpan, changed: Tensor, learnt: DynamicCloud) -> SpanContent:
        """Return what was `learnt` in a span, whose still Gaussians are the `changed` ones [C] of the scene."""
        own = {kind: getattr(learnt.still, kind).detach().clone() for kind in OWN}
        movers = DynamicCloud.from_state({**learnt.state(), "tensors": _detached_movers(learnt)})
        return cls(clip, changed, **own, cloud=movers)

    def state(self) -> dict[str, Any]:
        """Return tensors and numbers, for a checkpoint: as small as no picture tells from more."""
        own = {kind: stored(kind, getattr(self, kind)) for kind in ("changed", *OWN)}
        cloud = self.cloud.state() if self.cloud else None
        if cloud:
            cloud["tensors"] = {name: stored(name, tensor) for name, tensor in cloud["tensors"].items()}
        return {"clip": [self.clip.first_s, self.clip.last_s], **own, "cloud": cloud}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> SpanContent:
        """Return the content whose `state` this is."""
        cloud = state["cloud"]
        if cloud:
            tensors = {name: restored(tensor) for name, tensor in cloud["tensors"].items()}
            cloud = DynamicCloud.from_state({**cloud, "tensors": tensors})
        own = {kind: restored(state[kind]) for kind in ("changed", *OWN)}
        return cls(TimeSpan(*state["clip"]), **own, cloud=cloud)


def _detached_movers(learnt: DynamicCloud) -> dict[str, Tensor]:
    empty = vars(nothing())
    tensors = {name: tensor.detach().clone() for name, tensor in learnt.tensors() if not name.startswith("still.")}
    return tensors | {f"still.{name}": tensor for name, tensor in empty.items()}


@dataclass(frozen=True)
class _Cut(Sequence[SpanContent]):
    """The spans of these `numbers`, cut to `clip`; each is read when it is asked for."""

    spans: Sequence[SpanContent]
    numbers: Sequence[int]
    clip: TimeSpan

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return replace(self, numbers=self.numbers[place])
        span = self.spans[self.numbers[place]]
        first_s, last_s = max(span.clip.first_s, self.clip.first_s), min(span.clip.last_s, self.clip.last_s)
        return replace(span, clip=TimeSpan(first_s, last_s))


@dataclass
class SpannedScene:
    """N still Gaussians beside the contents of spans, in order of time; see `scene_model.SceneModel`."""

    still: GaussianCloud
    spans: Sequence[SpanContent]
    clip: TimeSpan
    light: Tensor = field(default_factory=lambda: torch.ones(1))
    dilation_px2: float = GUARDS.dilation_px2
    unit: ClassVar[str] = "Gaussians"
    kind: ClassVar[str] = "spans"

    def __post_init__(self) -> None:
        if not self.spans:
            raise ReconstructionError("found a scene of no span", "at least one")

    @classmethod
    def over(cls, scene: DynamicCloud | SpannedScene, clip: TimeSpan) -> SpannedScene:
        """Return the part of a scene that lies in `clip`: the spans that it touches, cut to it; steady light."""
        whole = scene if isinstance(scene, SpannedScene) else cls._of_one(scene)
        clips = [span.clip for span in whole.spans]
        touched = [n for n, own in enumerate(clips) if own.first_s < clip.last_s and clip.first_s < own.last_s]
        return cls(whole.still, _Cut(whole.spans, touched, clip), clip, dilation_px2=whole.dilation_px2)

    @classmethod
    def _of_one(cls, scene: DynamicCloud) -> SpannedScene:
        """Return a scene without spans as one that has one."""
        span = replace(SpanContent.as_usual(scene.clip), cloud=scene if len(scene.moving) else None)
        return cls(scene.still, [span], scene.clip, dilation_px2=scene.dilation_px2)

    def __len__(self) -> int:
        return len(self.still) + len(self.moving)

    @property
    def networks(self) -> bool:
        """Tell that no networks or grids move the Gaussians."""
        return False

    @property
    def moving(self) -> range:
        """The movers of all spans, by number."""
        return range(sum(len(span.cloud.moving) for span in self.spans if span.cloud))

    def number_at(self, instant_s: float) -> int:
        """Return the number of the span that an instant of the rig clock lies in; beyond the ends the outer ones."""
        firsts = [span.clip.first_s for span in self.spans]
        return max(0, bisect.bisect_right(firsts, instant_s) - 1)

    def part(self, number: int) -> DynamicCloud:
        """Return the scene of a span by itself: its still Gaussians as they are there, and its movers."""
        span = self.spans[number]
        still = self.still
        if len(span.changed):
            changed = {kind: getattr(still, kind).index_copy(0, span.changed, getattr(span, kind)) for kind in OWN}
            still = GaussianCloud(**{**vars(still), **changed})
        if span.cloud:
            return replace(span.cloud, still=still, dilation_px2=self.dilation_px2)
        motion = PolynomialMotion.at_rest(torch.zeros(0), 1.0)
        return DynamicCloud(still, nothing(), motion, span.clip, self._light_over(span.clip), self.dilation_px2)

    def _light_over(self, clip: TimeSpan) -> Tensor:
        planes = len(self.light)
        first, last = (round(self.clip.fraction(end_s) * planes) for end_s in (clip.first_s, clip.last_s))
        return self.light[min(first, planes - 1) : max(last, first + 1)]

    def at(self, instant_s: float) -> Instantaneous:
        """Return all Gaussians that are there at one instant of the rig clock."""
        return self.part(self.number_at(instant_s)).at(instant_s)

    @property
    def changes(self) -> bool:
        """Tell whether the scene differs between instants."""
        return any(span.cloud or len(span.changed) for span in self.spans)

    def look(self, camera: Camera, instant_s: float) -> View:
        """Return what `camera` sees at `instant_s` on the rig clock, through its lens."""
        return self.part(self.number_at(instant_s)).look(camera, instant_s)

    def positions(self, instant_s: float) -> Tensor:
        """Return the positions [N + M, 3] in m of the Gaussians that are there at an instant of the rig clock."""
        return self.at(instant_s).means

    def movers(self, instant_s: float) -> tuple[Tensor, Tensor]:
        """Return positions [M, 3] in m and opacities [M] of the moving Gaussians at an instant of the rig clock."""
        return self.part(self.number_at(instant_s)).movers(instant_s)

    def rates(self) -> Mapping[str, Rate]:
        """Return no rate: a joined scene is learnt no more."""
        return {}

    def advance(self, done: float) -> float:
        """Return `done`: no part of the scene has a stage of its own."""
        return done

    def penalty(self) -> None:
        """Return None: nothing is learnt any more."""
        return

    def opacity(self) -> Tensor:
        """Return the largest share of the light that each Gaussian takes, [N + M] in 0 to 1."""
        movers = [span.cloud.moving.opacity_logits for span in self.spans if span.cloud]
        return torch.cat([self.still.opacity_logits, *movers]).sigmoid()

    def tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Yield every stored tensor with its name, `still.means` to `spans.3.moving.means`."""
        for key, tensor in vars(self.still).items():
            yield f"still.{key}", tensor
        for number, span in enumerate(self.spans):
            for kind in ("changed", *OWN):
                yield f"spans.{number}.{kind}", getattr(span, kind)
            for name, tensor in span.cloud.tensors() if span.cloud else ():
                yield f"spans.{number}.{name}", tensor

    def to(self, kind: torch.dtype | torch.device) -> SpannedScene:
        """Refuse: a joined scene is made and shown in float32 on the processor."""
        raise ReconstructionError(f"found a scene of spans, wanted as {kind}", "float32 on the processor")

    def state(self) -> dict[str, Any]:
        """Return tensors, numbers and names, for a checkpoint."""
        return {
            "model": self.kind,
            "clip": [self.clip.first_s, self.clip.last_s],
            "light": self.light.clone(),
            "dilation_px2": self.dilation_px2,
            "still": {name: stored(name, tensor.detach().clone()) for name, tensor in vars(self.still).items()},
            "spans": [span.state() for span in self.spans],
        }

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> SpannedScene:
        """Return the scene whose `state` this is; raises ReconstructionError for other content."""
        try:
            spans = [SpanContent.from_state(span) for span in state["spans"]]
            still = GaussianCloud(**{name: restored(kept) for name, kept in state["still"].items()})
            dilation_px2 = state.get("dilation_px2", UNSAID_PX2)
            return cls(still, spans, TimeSpan(*state["clip"]), state["light"], dilation_px2)
        except (KeyError, TypeError, ValueError) as error:
            found, expected = "found a scene of spans that lacks something", "it as this version stores it"
            raise ReconstructionError(found, expected, "train again") from error


def nothing() -> GaussianCloud:
    """Return no Gaussians."""
    return GaussianCloud(torch.zeros(0, 3), torch.zeros(0, 4), torch.zeros(0, 3), torch.zeros(0), torch.zeros(0, 1))
