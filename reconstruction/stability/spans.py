"""Defines cases of long recordings in spans: seams of a million planes, both sides of a seam, lifetimes of zero."""

import math

import numpy as np
import torch

from reconstruction.gaussians.course import LEAST_DURATION, MOST_DURATION
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.rigid import RigidMotion
from reconstruction.gaussians.spanned import SpanContent, SpannedScene, nothing
from reconstruction.run.spans import OVERLAP, Span, cut
from reconstruction.scene_model import TimeSpan, gain_at
from reconstruction.stability.case import Case, Observation
from reconstruction.stability.models import cloud_of
from rigs.clock import RigClock

PLANES, EVERY = 1_000_000, 7  # of a recording, and spans from one that is looked at to the next
CLOCKS = (RigClock(20_000.0), RigClock(1e6 / 3, 10**9), RigClock(19_999.7, 7))
KNOTS = 17
SPEED_M_S, TURNS_A_S = 3.0, 20.0  # of a body in front of the cameras
SIDES = (Span(0, 400), Span(400, 800))


def _many_seams(_: str) -> Observation:
    """Look at the first and last planes of spans: the span that they are shown by, and its light."""
    spans, wrong, error = cut(PLANES), 0, 0.0
    gains = torch.from_numpy(1 + 0.3 * np.sin(np.arange(PLANES) / 57.0)).float()
    for clock in CLOCKS:
        whole = TimeSpan.of_planes(clock, 0, PLANES)
        usual = [SpanContent.as_usual(TimeSpan.of_planes(clock, span.first, span.last)) for span in spans]
        scene = SpannedScene(nothing(), usual, whole, gains)
        for number, span in list(enumerate(spans))[::EVERY]:
            planes = (span.first, span.last - 1)
            wrong += sum(scene.number_at(clock.instant_s(plane)) != number for plane in planes)
            part = scene.part(number)
            for plane in planes:
                gain = float(gain_at(part.light, part.clip.fraction(clock.instant_s(plane))))
                error = max(error, abs(gain - float(gains[plane])))
    return Observation(f"{len(spans):,} spans: {wrong} planes in another, light {error:.0e} off", error + wrong)


def _pose(instant_s: float) -> tuple[list[float], list[float]]:
    half = math.pi * TURNS_A_S * instant_s
    return [math.cos(half), 0.0, 0.0, math.sin(half)], [SPEED_M_S * instant_s, 0.1, 2.0]


def _stored(span: Span, clock: RigClock, durations: float = MOST_DURATION) -> SpanContent:
    """Return a span as it is stored, with riders of one body that moves as `_pose` says."""
    grown = span.grown(OVERLAP, SIDES[-1].last)
    clip = TimeSpan.of_planes(clock, grown.first, grown.last)
    moving = cloud_of("bases").moving
    poses = [_pose(at_s) for at_s in np.linspace(clip.first_s, clip.last_s, KNOTS)]
    quats, centers = (torch.tensor([list(column)], dtype=torch.float32) for column in zip(*poses, strict=True))
    riders = torch.zeros(len(moving), dtype=torch.int64)
    windows = torch.full((len(moving),), 0.5), torch.full((len(moving),), durations).log()
    motion = RigidMotion(riders, quats, centers, torch.zeros(0, 3), *windows)
    learnt = DynamicCloud(nothing(), moving, motion, clip)
    own = TimeSpan.of_planes(clock, span.first, span.last)
    return SpanContent.from_state(SpanContent.of(own, riders[:0], learnt).state())


def _both_sides(_: str) -> Observation:
    """Compare the places of a body around a seam by the span before it and by the one after it."""
    clock, error = CLOCKS[0], 0.0
    before, after = (_stored(span, clock).cloud for span in SIDES)
    assert before is not None
    assert after is not None
    for plane in range(SIDES[0].last - OVERLAP, SIDES[0].last + OVERLAP):
        sides = [cloud.movers(clock.instant_s(plane))[0] for cloud in (before, after)]
        error = max(error, float((sides[0] - sides[1]).norm(dim=1).max()))
    return Observation(f"{2 * OVERLAP} planes around a seam: both sides {error:.1e} m apart", error)


def _lifetimes(_: str) -> Observation:
    """Store lifetimes of zero, shortest ones and those without end; only those without end show half a clip later."""
    clock, found = CLOCKS[0], []
    for duration in (0.0, LEAST_DURATION, MOST_DURATION, math.inf):
        cloud = _stored(SIDES[0], clock, duration).cloud
        assert cloud is not None
        found.append([float(cloud.movers(cloud.clip.instant_s(u))[1].max()) for u in (0.5, 1.0)])
    sound = all(math.isfinite(value) for pair in found for value in pair)
    late = [pair[1] / pair[0] for pair in found]
    error = max(late[0], late[1], abs(late[2] - 1), abs(late[3] - 1)) if sound else math.inf
    said = " ".join(f"{share:.3g}" for share in late)
    return Observation(f"{said} of the opacity half a clip later", error)


CASES = (
    Case(None, "spans of a million planes", "every plane in its span, in its light", 1e-3, _many_seams),
    Case(None, "both sides of a seam", "the same places", 1e-3, _both_sides),
    Case(None, "lifetimes of spans", "0 0 1 1 of the opacity half a clip later", 1e-5, _lifetimes),
)
