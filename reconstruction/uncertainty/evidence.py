"""Gathers what the training views tell of each Gaussian: how well the pixels that it fills fit, and who sees it.

Letters: N Gaussians, M moving ones, V training views. A Gaussian has in each pixel the weight with which its light is
blended there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from acquisition.progress import Progress, silent
from reconstruction.errors import BadRunError
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.images.composite import CompositeSource
from reconstruction.native import shared_out
from reconstruction.rendering.native import attribute
from reconstruction.rendering.result import GUARDS, Rendering
from reconstruction.run.spans import Span
from rigs.camera import Camera
from rigs.clock import RigClock

INSTANTS, SPAN_INSTANTS = 4, 2  # instants that are compared: of a recording in one piece, and of each span
FEW_PX = 4.0  # pixels of the mean misfit that a Gaussian's own is mixed with
SEEN_PX = 1.0  # least pixels that a Gaussian fills in a view that sees it
HOLES = 0.01  # share of the pixels that are taken for holes in which something of the usual light was missed
Views = Mapping[str, tuple[Camera, CompositeSource]]
GaussianScene = DynamicCloud | SpannedScene
Attributed = Callable[[Camera, Callable[[Rendering], Tensor]], tuple[Rendering, Tensor]]  # `attribute` of one cloud


class Evidence(NamedTuple):
    """The knowledge of N Gaussians.

    `misfit` [N]: the mean square of render minus target in their pixels, of the square of white. `seen` [N, V], bool:
    the views that see them.
    """

    misfit: Tensor
    seen: Tensor

    def beside(self, other: Evidence) -> Evidence:
        """Return what is known of these Gaussians and then of others."""
        return Evidence(*(torch.cat(pair) for pair in zip(self, other, strict=True)))


@dataclass
class _Tally:
    """Sums over pictures: pixels [N, V] that Gaussians fill, and squared misfits [N] there."""

    pixels: Tensor
    squares: Tensor

    @classmethod
    def of(cls, count: int, views: int) -> _Tally:
        return cls(torch.zeros(count, views), torch.zeros(count))

    def add(self, other: _Tally) -> None:
        """Add other sums of the same Gaussians."""
        self.pixels += other.pixels
        self.squares += other.squares

    def cut(self, first: int, last: int | None = None) -> _Tally:
        """Return the sums of a range of Gaussians."""
        return _Tally(self.pixels[first:last], self.squares[first:last])

    def evidence(self, mean: Tensor) -> Evidence:
        """Return what they tell; a Gaussian that fills few pixels has nearly the `mean` misfit."""
        misfit = (self.squares + FEW_PX * mean) / (self.pixels.sum(dim=1) + FEW_PX)
        return Evidence(misfit, self.pixels >= SEEN_PX)


@dataclass
class _Holes:
    """Sums over pictures: holes in pixels, squares of the light that shows there; pixels, and squares of all light."""

    sums: Tensor = field(default_factory=lambda: torch.zeros(4))

    @property
    def void(self) -> float:
        """The mean square of the light that shows in a hole: that of all light, unless the views have seen holes."""
        holes, squares, pixels, light = self.sums.tolist()
        assumed = HOLES * max(pixels, 1.0)
        return (squares + assumed * light / max(pixels, 1.0)) / (holes + assumed)


@dataclass(frozen=True)
class SceneEvidence:
    """The evidence of a scene: of its N still Gaussians, and of the movers of each span, or of all in one piece.

    `centres` [V, 3]: where the training cameras stand, m in the rig frame. `white`: the intensity that misfits are
    relative to, spikes per tick. `void`: the mean square, over that of white, of the light where nothing is drawn.
    """

    still: Evidence
    movers: Sequence[Evidence]
    centres: Tensor
    white: float
    void: float

    def at(self, number: int) -> Evidence:
        """Return what is known of the Gaussians that are there in a span, the still ones first."""
        return self.still.beside(self.movers[number])

    def state(self) -> dict[str, Any]:
        """Return tensors and numbers, for a file; misfits as their roots, which half precision holds well."""
        packed = [{"misfit": e.misfit.sqrt().half(), "seen": _packed(e.seen)} for e in (self.still, *self.movers)]
        numbers = {"white": self.white, "void": self.void}
        return {"still": packed[0], "movers": packed[1:], "centres": self.centres, **numbers}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> SceneEvidence:
        """Return the evidence whose `state` this is; raises BadRunError for other content."""
        try:
            views = len(state["centres"])
            still, *movers = (
                Evidence(kept["misfit"].float().square(), _unpacked(kept["seen"], views))
                for kept in (state["still"], *state["movers"])
            )
            return cls(still, movers, state["centres"], float(state["white"]), float(state["void"]))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadRunError(
                "found other evidence than this version stores", do="run the report stage again"
            ) from error


def _packed(seen: Tensor) -> Tensor:
    return torch.from_numpy(np.packbits(seen.numpy(), axis=1))


def _unpacked(packed: Tensor, views: int) -> Tensor:
    return torch.from_numpy(np.unpackbits(packed.numpy(), axis=1, count=views).astype(bool))


@torch.no_grad()
def gather(
    scene: GaussianScene,
    views: Views,
    clock: RigClock,
    spans: Sequence[Span],
    white: float,
    progress: Progress = silent,
) -> SceneEvidence:
    """Compare the scene with the targets of its training views, and return what that tells of each Gaussian.

    `spans`: those of the recording, or one that is all of it. `white`: spikes per tick, above zero.
    """
    still, movers, holes = _Tally.of(len(scene.still), len(views)), [], _Holes()
    for number, (part, planes) in enumerate(_compared(scene, spans)):
        own = _Tally.of(len(part), len(views))
        for plane in planes:
            now, guards = part.at(clock.instant_s(plane)), GUARDS._replace(dilation_px2=part.dilation_px2)
            holes.sums += _compare(own, partial(attribute, now, guards=guards), views, plane, white)
        still.add(own.cut(0, len(scene.still)))
        movers.append(own.cut(len(scene.still)))
        progress((number + 1) / len(spans), f"evidence of span {number + 1} of {len(spans)}")
    filled = sum(float(tally.pixels.sum()) for tally in (still, *movers))
    mean = sum(float(tally.squares.sum()) for tally in (still, *movers)) / max(filled, 1.0)
    centres = torch.tensor(np.stack([camera.center for camera, _ in views.values()]), dtype=torch.float32)
    found = [tally.evidence(torch.tensor(mean)) for tally in (still, *movers)]
    return SceneEvidence(found[0], found[1:], centres, white, holes.void)


def _compared(scene: GaussianScene, spans: Sequence[Span]) -> Iterator[tuple[DynamicCloud, list[int]]]:
    """Yield the scene of each span and the planes to compare it at; none where a span is as most others are."""
    if isinstance(scene, DynamicCloud):
        yield scene, _planes(spans[0], INSTANTS)
        return
    resting = [not (content.cloud or len(content.changed)) for content in scene.spans]
    for number, span in enumerate(spans):
        left_out = resting[number] and not (all(resting) and number == len(spans) // 2)
        yield scene.part(number), [] if left_out else _planes(span, SPAN_INSTANTS)


def _planes(span: Span, count: int) -> list[int]:
    """Return so many planes, evenly within a span; fewer where it has fewer."""
    count = min(count, len(span))
    return [span.first + (2 * i + 1) * len(span) // (2 * count) for i in range(count)]


def _compare(tally: _Tally, attributed: Attributed, views: Views, plane: int, white: float) -> Tensor:
    """Add to the sums what the views show at a plane, `attributed` to Gaussians; return the sums of `_Holes`."""

    def compared(view: tuple[Camera, CompositeSource]) -> tuple[Tensor, Tensor]:
        camera, source = view
        covered, target = torch.from_numpy(_covered(source)), torch.from_numpy(source.at(plane)) / white

        def maps(seen: Rendering) -> Tensor:
            return torch.stack([covered, covered * (seen.intensity / white - target).square()])

        seen, sums = attributed(camera, maps)
        ones, squares = maps(seen)
        hole = 1 - seen.alpha
        return sums, torch.stack([(hole * ones).sum(), (hole * squares).sum(), ones.sum(), (ones * target**2).sum()])

    holes = torch.zeros(4)
    for view, (sums, of_holes) in enumerate(shared_out(compared, views.values())):
        tally.pixels[:, view] += sums[:, 0]
        tally.squares += sums[:, 1]
        holes += of_holes
    return holes


def _covered(source: CompositeSource) -> np.ndarray:
    """Return 1 where a view's camera has seen a pixel whole, else 0, [H, W]."""
    way = source.straightening
    return np.ones(source.moving.shape, np.float32) if way is None else way.covered.astype(np.float32)
