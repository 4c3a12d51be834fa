"""Trains a recording in spans: the still scene once from all of it, then in each span what differs from that.

Nothing of a span depends on another, so they can be learnt in any order; each ends in a file of its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpanCloud, SpanContent
from reconstruction.images.background import dimming
from reconstruction.initialization.bodies import Bodies
from reconstruction.initialization.choosing import PART_S, choose_bodies, ways_within
from reconstruction.initialization.judging import judge
from reconstruction.initialization.points import Points, Seeds, sample_points
from reconstruction.initialization.pyramid import swept_maps
from reconstruction.initialization.sweep import NOISE, SweepOptions, depth_range_m
from reconstruction.losses.picture import inverse_depth
from reconstruction.methods.catalogue import METHODS
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.artefacts import short_images
from reconstruction.pipeline.points_stage import moving_planes, moving_points
from reconstruction.pipeline.span_artefacts import SpanView, read_span_views, read_still_views
from reconstruction.pipeline.train_stage import settings_of
from reconstruction.run.folder import RunFolder
from reconstruction.run.spans import OVERLAP, STILL_SHARE
from reconstruction.scene_model import TimeSpan
from reconstruction.training.changed_pixels import look_again, unsettled
from reconstruction.training.trainer import Trainer, train
from reconstruction.training.view import TrainingView
from rigs.clock import RigClock

OnStep = Callable[[Trainer, float, float], None]  # of a trainer, the share that is done, and the loss
Done = Callable[[int], float]  # the share of a training that is done after so many steps
SPAN_ROOM_BYTES = 8_000_000  # for a view's short images, few of which are asked for twice in so short a training
FOCUS_PX = 8  # pixels around movers that steps look at
MOST_MOVING = 2.0  # times the plan's moving Gaussians that a span may have, where it sees more than others


def learn_still(run: RunFolder, recording: Recording, done: Done, on_step: OnStep) -> GaussianCloud:
    """Return the still scene, learnt from the backgrounds of all training views."""
    views = _still_views(run, recording)
    cameras = [view.camera for view in views]
    clip = TimeSpan.of_planes(recording.rig.clock, 0, recording.planes)
    points = artefacts.read(run, artefacts.STILL, Points)
    method = METHODS["static"]
    cloud = method.start(Seeds(points, Points.none(), clip, 1, run.config.seed, cameras, _no_bodies))
    assert isinstance(cloud, DynamicCloud)
    light = artefacts.read_light(run)
    if light.flickers:
        cloud.light = torch.from_numpy(light.gains)
    settings = replace(settings_of(run, method, views), times=False, image_planes=1, ends_early=False)
    trainer = Trainer(cloud, views, settings, recording.rig.clock, run.config.seed)
    train(trainer, lambda: done(trainer.steps), lambda share, loss: on_step(trainer, share, loss))
    trainer.settle()
    learnt = trainer.cloud
    assert isinstance(learnt, DynamicCloud)
    return GaussianCloud(**{name: tensor.detach() for name, tensor in vars(learnt.still).items()})


def _still_views(run: RunFolder, recording: Recording) -> list[TrainingView]:
    """Return the training views of the still scene; where no background is sure, nothing is compared."""
    found = []
    for view, (camera, source) in read_still_views(run, recording).items():
        depth = inverse_depth(run.read_array(artefacts.DEPTH.format(view=view)))
        void, sure = artefacts.read_empty(run, view), source.background.trusted
        empty = None if void is None else torch.from_numpy(void)
        known = None if sure.all() else torch.from_numpy(sure.astype(np.float32))
        found.append(TrainingView(camera, source, inverse_depth=depth, empty=empty, known=known))
    return found


def learn_span(
    run: RunFolder, recording: Recording, number: int, still: GaussianCloud, done: Done, on_step: OnStep
) -> SpanContent:
    """Return what the span `number` has beside the `still` scene, learnt from its planes and a few beyond its ends."""
    span, clock = run.plan.spans[number], recording.rig.clock
    grown = span.grown(OVERLAP, recording.planes)
    seen = _looked_at_again(run, read_span_views(run, recording, number, grown))
    sources = [replace(one.source, room_bytes=SPAN_ROOM_BYTES) for one in seen]
    views = [TrainingView(one.camera, s, focus=_around(one.shown)) for one, s in zip(seen, sources, strict=True)]
    cloud, changed = _started(run, recording, seen, still, len(grown))
    own = TimeSpan.of_planes(clock, span.first, span.last)
    if not len(cloud.moving) and not len(changed):  # what was seen to move has no depth
        return SpanContent.as_usual(own)
    light = artefacts.read_light(run)
    if light.flickers:
        cloud.light = torch.from_numpy(light.gains[grown.first : grown.last])
    settings = replace(settings_of(run, METHODS[run.plan.model], views), ends_early=False)
    trainer = Trainer(cloud, views, settings, RigClock(clock.tick_rate_hz), run.config.seed + number)
    train(trainer, lambda: done(trainer.steps), lambda share, loss: on_step(trainer, share, loss))
    trainer.settle()
    learnt = trainer.cloud  # another one than it began with, where parts were joined into bodies
    assert isinstance(learnt, SpanCloud)
    learnt.clip = TimeSpan.of_planes(clock, grown.first, grown.last)
    return SpanContent.of(own, changed, learnt)


def _looked_at_again(run: RunFolder, seen: Mapping[str, SpanView]) -> list[SpanView]:
    """Return the views with those pixels among the moving ones that change too little for the plan to tell."""
    views = list(seen.values())
    for i, mask in look_again([TrainingView(one.camera, one.source) for one in views]).items():
        source = views[i].source
        source = source.retargeted(source.moving | mask, partial(short_images, run.plan))
        views[i] = views[i]._replace(source=source, stays=views[i].stays & ~mask)
    return views


def _around(moving: NDArray[np.bool_]) -> torch.Tensor:
    """Return where movers and what they push aside are compared: 1 on `moving` pixels [H, W] and near them, else 0."""
    return torch.from_numpy(cv2.dilate(moving.astype(np.float32), np.ones((2 * FOCUS_PX + 1,) * 2, np.uint8)))


def _started(
    run: RunFolder, recording: Recording, seen: Sequence[SpanView], still: GaussianCloud, planes: int
) -> tuple[SpanCloud, torch.Tensor]:
    """Return the start of a span of so many planes, and which still Gaussians [C] it may change."""
    rng, cameras = np.random.default_rng(run.config.seed), [one.camera for one in seen]
    clock = RigClock(recording.rig.tick_rate_hz)  # of the span alone, while it is learnt
    instants = {plane: clock.instant_s(plane) for plane in moving_planes(planes, run.plan.model, run.plan.sweeps)}
    moving, resting = _moving(run, seen, instants, rng), _resting(run, seen, rng)
    clip = TimeSpan.of_planes(clock, 0, planes)

    def bodies() -> Bodies:
        judged = lambda found: judge(replace(movers, bodies=lambda: found), views, clock, still)  # noqa: E731
        part_s = None if run.config.budget_s is None else run.config.budget_s / len(run.plan.spans)
        found = choose_bodies(moving, list(instants.values()), judged, ways_within(part_s, PART_S))
        return found.bodies.beside(len(resting))

    views = [(one.camera, one.source) for one in seen]
    movers = Seeds(Points.none(), moving, clip, run.plan.sweeps, run.config.seed, cameras, bodies)
    seeds = replace(movers, moving=Points.joined([moving, resting]), resting=len(resting))
    begun = METHODS[run.plan.model].start(seeds)
    assert isinstance(begun, DynamicCloud)
    near = unsettled(still.means, cameras, {i: one.shown for i, one in enumerate(seen)})
    own, changed = still.select(near), torch.nonzero(near).squeeze(1)
    return SpanCloud(own, begun.moving, begun.motion, clip, common=still.select(~near)), changed


def _moving(
    run: RunFolder, seen: Sequence[SpanView], instants: Mapping[int, float], rng: np.random.Generator
) -> Points:
    """Return the points of movers at `instants` (s) of planes: as many as the plan has for so many pixels."""
    share = float(np.mean([one.source.moving.mean() for one in seen]))
    usual = float(next(d.facts for d in run.plan.decisions if d.about == "spans")["moving_share"])
    count = round(run.plan.moving_gaussians * min(MOST_MOVING, share / max(usual, 1e-9))) // run.plan.sweeps
    if not count:
        return Points.none()
    sources, cameras = {one.camera.id: one.source for one in seen}, [one.camera for one in seen]
    return Points.joined([moving_points(sources, cameras, at, count, rng) for at in instants.items()])


def _resting(run: RunFolder, seen: Sequence[SpanView], rng: np.random.Generator) -> Points:
    """Return the points of things that stand in few other spans, as dense as those of the still scene."""
    share = float(np.mean([one.stays.mean() for one in seen]))
    if share < STILL_SHARE:
        return Points.none()
    cameras, images = [one.camera for one in seen], [one.source.background.image for one in seen]
    noise = NOISE * dimming(float(np.mean([one.source.white for one in seen])))
    masks = [one.stays for one in seen]
    maps = swept_maps(cameras, images, SweepOptions(*depth_range_m(cameras), noise=noise), masks)
    return sample_points(maps, images, masks, round(share * run.plan.still_gaussians), 0.0, rng)


def _no_bodies() -> Bodies:
    raise AssertionError("a still scene has no bodies")
