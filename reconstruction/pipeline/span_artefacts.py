"""The artefacts of a recording that is reconstructed in spans.

The plan stage writes PLANNED, the images stage MASKS and the list of the parts, the train stage a file for each part,
which is whole or absent. Letters: S spans, H rows, W columns.
"""

from __future__ import annotations

import bisect
import functools
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acquisition.recording.reader import Recording
from reconstruction.images.background import Background
from reconstruction.images.composite import CompositeSource
from reconstruction.images.mending import mended
from reconstruction.pipeline.artefacts import read_sources, read_views, short_images, straight_views
from reconstruction.run.folder import RunFolder
from reconstruction.run.parts import Part, parts_of
from reconstruction.run.plan import LEAST_VIEWS
from reconstruction.run.spans import STILL_SHARE, Span
from rigs.camera import Camera

PLANNED = "plan/moving_spans_{view}"  # pixels of a view that see something move, by span
MASKS = "images/moving_spans_{view}"  # the same, with those that show something else than the background
BLIND = "images/blind_spans_{view}"  # spans [S] in which a view is dark
Masks = NDArray[np.bool_]
Mask = NDArray[np.bool_]
Sources = dict[str, CompositeSource]
Views = dict[str, tuple[Camera, CompositeSource]]


class SpanView(NamedTuple):
    """A training camera and its images of a span; `stays` [H, W] are pixels of things that stand in few other spans."""

    camera: Camera
    source: CompositeSource
    stays: Mask

    @property
    def shown(self) -> Mask:
        """The pixels [H, W] that show something else than the still scene."""
        return self.source.moving | self.stays


def write_masks(run: RunFolder, name: str, view: str, masks: Masks) -> None:
    """Write the masks [S, H, W] of a view, eight pixels a byte."""
    run.write_array(name.format(view=view), np.packbits(masks.reshape(len(masks), -1), axis=1))


def read_masks(run: RunFolder, name: str, view: str, size: tuple[int, ...]) -> Masks:
    """Read the masks [S, H, W] of a view of this size (H, W)."""
    return _unpacked(run.read_array(name.format(view=view)), size)


def _read_mask(run: RunFolder, name: str, view: str, number: int, size: tuple[int, ...]) -> Mask:
    """Read the mask [H, W] of one span; those of the others would stay in memory with it."""
    return _unpacked(run.read_array(name.format(view=view))[number], size)


def _unpacked(packed: NDArray[np.uint8], size: tuple[int, ...]) -> Masks:
    count = math.prod(size)
    return np.unpackbits(packed, axis=-1, count=count).view(bool).reshape(*packed.shape[:-1], *size)


def read_still_views(run: RunFolder, recording: Recording) -> Views:
    """Return the training cameras and what they see of the still scene, without anything that moves."""
    nowhere = lambda source: np.zeros_like(source.moving)  # noqa: E731
    sources = {view: replace(source, moving=nowhere(source)) for view, source in read_sources(run, recording).items()}
    return straight_views(recording, sources)


def read_span_views(run: RunFolder, recording: Recording, number: int, span: Span) -> dict[str, SpanView]:
    """Return the training cameras and what they see in the planes of `span`, as the span `number` shows it."""
    sources = _span_sources(run, recording, number, span)
    views = straight_views(recording, sources)
    stays = {view: _stays(run, view, number, source.moving.shape) for view, source in sources.items()}
    return {view: SpanView(*seen, seen[1].carried_mask(stays[view])) for view, seen in views.items()}


def _stays(run: RunFolder, view: str, number: int, size: tuple[int, ...]) -> Mask:
    """Return the recorded pixels [H, W] that show what stands there in the span `number`, and not the background."""
    shown, moving = (_read_mask(run, name, view, number, size) for name in (MASKS, PLANNED))
    return shown & ~moving


def _span_sources(run: RunFolder, recording: Recording, number: int, span: Span) -> Sources:
    """Return the images of `span`; where something stands in the span `number`, that is their background."""
    own, sources = run.plan.spans[number], {}
    for view, whole in read_sources(run, recording).items():
        if run.read_array(BLIND.format(view=view))[number]:
            continue
        moving = _read_mask(run, PLANNED, view, number, whole.moving.shape)
        stays, part = _stays(run, view, number, moving.shape), whole.part(span.first, span.last)
        if stays.any():
            light = whole.counts(own.first, own.last) / np.float32(len(own) * whole.light.over(own.first, own.last))
            whole.stream.let_go()
            still = whole.background
            image = np.where(stays, mended(light, whole.useless(own.last)), still.image)
            part = replace(part, background=Background(image, still.trusted | stays, still.stuck))
        sources[view] = part.retargeted(moving, partial(short_images, run.plan))
    return sources


def moving_spans(run: RunFolder) -> dict[int, float]:
    """Return the share of the pixels that differ from the still scene, by the number of the span.

    Spans in which nothing does, or that fewer than two views see, are left out.
    """
    packed = [run.read_array(MASKS.format(view=view)) for view in run.plan.views]
    pixels = np.stack([np.bitwise_count(masks).sum(axis=1) / (8 * masks.shape[1]) for masks in packed])
    seeing = np.stack([~run.read_array(BLIND.format(view=view)) for view in run.plan.views])
    shares = (pixels * seeing).sum(axis=0) / np.maximum(seeing.sum(axis=0), 1)
    found = np.flatnonzero((shares >= STILL_SHARE) & (seeing.sum(axis=0) >= LEAST_VIEWS))
    return dict(zip(found.tolist(), shares[found].tolist(), strict=True))


def parts_to_learn(run: RunFolder) -> list[Part]:
    """Return the parts of the run's training: the still scene, which all others begin with, and the spans."""
    return parts_of(moving_spans(run))


def read_targets(run: RunFolder, recording: Recording) -> Views:
    """Return the training cameras and what they see at any plane of the recording, movers included."""
    views = read_views(run, recording)
    if not run.plan.spans:
        return views
    parts = _parts(
        lambda number, span: {v: seen.source for v, seen in read_span_views(run, recording, number, span).items()}
    )
    return {v: (camera, _spanned(run, source, parts, v)) for v, (camera, source) in views.items()}


def read_recorded_targets(run: RunFolder, recording: Recording) -> Sources:
    """Return what the training cameras recorded at any plane, movers included, as their lenses bent it."""
    sources = read_sources(run, recording)
    if not run.plan.spans:
        return sources
    parts = _parts(partial(_span_sources, run, recording))
    return {view: _spanned(run, source, parts, view) for view, source in sources.items()}


def _parts(read: Callable[[int, Span], Sources]) -> Callable[[int, Span], Sources]:
    """Return `read`, which keeps the last two parts; threads that want the same one wait for the first that does."""
    kept, one_reads = functools.lru_cache(maxsize=2)(read), threading.Lock()

    def part(number: int, span: Span) -> Sources:
        with one_reads:
            return kept(number, span)

    return part


def _spanned(
    run: RunFolder, source: CompositeSource, parts: Callable[[int, Span], Sources], view: str
) -> SpannedSource:
    spans = run.plan.spans
    return SpannedSource.of(source, spans, lambda number: parts(number, spans[number]).get(view))


@dataclass(frozen=True, eq=False)
class SpannedSource(CompositeSource):
    """One camera's images of a recording in spans: those of the span that a plane lies in.

    `part_of` gives them by the number of the span, None for one in which the camera is dark: there nothing moves.
    """

    spans: Sequence[Span] = ()
    part_of: Callable[[int], CompositeSource | None] = field(kw_only=True)

    @classmethod
    def of(
        cls, source: CompositeSource, spans: Sequence[Span], part_of: Callable[[int], CompositeSource | None]
    ) -> SpannedSource:
        """Return the images of a camera whose still scene `source` has."""
        own = {f.name: getattr(source, f.name) for f in fields(CompositeSource)}
        return cls(**own, spans=spans, part_of=part_of)

    def at(self, plane: int) -> NDArray[np.float32]:
        """Return the image [H, W] at `plane` in spikes per tick."""
        number = bisect.bisect_right([span.first for span in self.spans], plane) - 1
        part = self.part_of(number)
        return part.at(plane - self.spans[number].first) if part else self.background.image * self.light.gains[plane]
