"""Cutting a recording into spans, and what of a plan may be learnt in them."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from acquisition.progress import silent
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.flicker import Light
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.span_plan import choose_spans, find_spans, span_masks
from reconstruction.run.spans import LEAST, Span, cut


@pytest.mark.parametrize(
    ("planes", "count"), [(1, 1), (400, 1), (599, 1), (600, 2), (800, 2), (801, 3), (4000, 10), (1_000_000, 2500)]
)
def test_spans_are_even_and_leave_nothing_out(planes, count):
    spans = cut(planes)
    assert len(spans) == count
    assert (spans[0].first, spans[-1].last) == (0, planes)
    assert all(a.last == b.first for a, b in pairwise(spans))
    lengths = [len(span) for span in spans]
    assert max(lengths) - min(lengths) <= 1
    assert count == 1 or max(lengths) <= 400


def test_a_span_grows_within_the_recording():
    assert Span(0, 100).grown(24, 1000) == Span(0, 124)
    assert Span(100, 200).grown(24, 1000) == Span(76, 224)
    assert Span(900, 1000).grown(24, 1000) == Span(876, 1000)


def fired(planes, rate):
    """Return a stream of 16x8 pixels that fire `rate` times a plane, at chance."""
    packed = np.packbits(np.random.default_rng(0).random((planes, 8, 16)) < rate, axis=2).reshape(planes, -1)
    return [SpikeStream(packed, PlaneLayout(16, 8), 20_000.0)]


LIT = fired(4000, 0.2)


def test_a_span_is_as_long_as_was_asked_for():
    assert len(choose_spans(ReconstructionConfig(span=100), "sweep", fired(1000, 0.001))) == 10


@pytest.mark.parametrize(("rate", "count"), [(0.2, 10), (0.03, 10), (0.0126, 6), (0.002, 1), (0.0, 1)])
def test_spans_are_longer_where_pixels_fire_seldom(rate, count):
    assert len(choose_spans(ReconstructionConfig(), "sweep", fired(4000, rate))) == count


@pytest.mark.parametrize(
    "choices",
    [{"model": "4dgs"}, {"model": "static"}, {"refine": "on"}, {"images": "clean"}, {"supervision": "image-variation"}],
)
def test_what_cannot_be_learnt_in_spans_is_learnt_in_one_piece(choices):
    assert choose_spans(ReconstructionConfig(**choices), "sweep", LIT) == (Span(0, 4000),)


def test_poses_that_training_refines_are_learnt_in_one_piece():
    assert len(choose_spans(ReconstructionConfig(), "sfm", LIT)) == 1
    assert len(choose_spans(ReconstructionConfig(), "natural", LIT)) == 10


def test_too_short_a_span_is_refused():
    with pytest.raises(BadRunError, match=f"found a span of {LEAST - 1} planes, expected at least {LEAST}"):
        ReconstructionConfig(span=LEAST - 1)


def test_a_mover_is_found_in_the_span_that_it_crosses():
    rng = np.random.default_rng(0)
    planes = (rng.random((400, 24, 24)) < 0.3).astype(np.uint8)
    planes[::3], planes[1::3], planes[2::3] = 1, 0, 0  # constant light fires evenly
    planes[200:300, 8:16, 8:16] = 1
    layout = PlaneLayout(24, 24)
    stream = SpikeStream(pack(planes, layout), layout, 20_000.0)
    masks = span_masks(stream, Light.steady(400), (Span(0, 180), Span(180, 400)))
    assert not masks[0].any()
    assert masks[1, 10, 10]
    assert not masks[1, 0, 0]


SIDE, EACH = 24, 200  # pixels of a square view, planes of a span


def stream_of(rates: Sequence[float], moving: Sequence[int] = ()) -> SpikeStream:
    """A view whose spans fire at even `rates`; in the spans numbered `moving` a bright square comes in half-way."""
    light = np.repeat(np.asarray(rates, np.float32), EACH)[:, None, None].repeat(SIDE, 1).repeat(SIDE, 2)
    for number in moving:
        light[number * EACH + EACH // 2 : (number + 1) * EACH, 8:16, 8:16] = 0.9
    planes = Sensor(SIDE, SIDE, "ideal", 1, 0).expose(light)
    return SpikeStream(pack(planes, PlaneLayout(SIDE, SIDE)), PlaneLayout(SIDE, SIDE), 20_000.0)


def found(*streams: SpikeStream) -> tuple[list[tuple[int, int]], list[bool]]:
    """The spans that are found, in EACH planes, and in which of them the first view sees movers."""
    planes = len(streams[0])
    views = {f"cam0{i}": stream for i, stream in enumerate(streams)}
    spans, masks = find_spans(views, Light.steady(planes), cut(planes, EACH), silent)
    return [(span.first // EACH, span.last // EACH) for span in spans], [bool(mask.any()) for mask in masks["cam00"]]


def test_neighbours_at_rest_are_one_span():
    steady = [0.25] * 7
    assert found(stream_of(steady, moving=[2, 5])) == (
        [(0, 2), (2, 3), (3, 5), (5, 6), (6, 7)],
        [False, True, False, True, False],
    )
    assert found(stream_of(steady)) == ([(0, 7)], [False])
    assert found(stream_of([0.25] * 3, moving=[0, 1, 2])) == ([(0, 1), (1, 2), (2, 3)], [True] * 3)


def test_a_camera_that_is_lost_parts_spans_at_rest():
    assert found(stream_of([0.25] * 4), stream_of([0.25, 0.25, 0.0, 0.0]))[0] == [(0, 2), (2, 4)]


def test_what_moves_too_slowly_to_be_seen_in_a_span_parts_spans_at_rest():
    """A square of a brightness of its own stands elsewhere in the second half."""
    light = np.full((4 * EACH, SIDE, SIDE), 0.25, np.float32)
    light[: 2 * EACH, 4:10, 4:10] = light[2 * EACH :, 12:18, 12:18] = 0.4
    planes = Sensor(SIDE, SIDE, "ideal", 1, 0).expose(light)
    layout = PlaneLayout(SIDE, SIDE)
    assert found(SpikeStream(pack(planes, layout), layout, 20_000.0)) == ([(0, 2), (2, 4)], [False, False])


def test_recordings_at_rest_have_no_spans_whatever_their_length():
    assert found(stream_of([0.25]))[0] == [(0, 1)]
    assert found(stream_of([0.25] * 60))[0] == [(0, 60)]
