"""Decides whether a recording is reconstructed in spans, and finds what moves in each."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import moving_pixels
from reconstruction.images.catalogue import GIVEN
from reconstruction.images.flicker import DARK, Light
from reconstruction.images.scarce import lit_spikes
from reconstruction.images.standing import unlike_share
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.definition import SWEEPS
from reconstruction.methods.ours import BASES
from reconstruction.parallel import each
from reconstruction.run.configuration import SWEPT, ReconstructionConfig
from reconstruction.run.decisions import Decision
from reconstruction.run.spans import PLANES, STILL_SHARE, Span, cut

LEAST_SPIKES = 10.0  # spikes in a span of a pixel that sees light, below which nothing in it can be told to move
SAMPLED, SAMPLED_VIEWS = 2000, 4  # planes in the middle of a recording, and views, that tell how often pixels fire
UNADJUSTED = ("sfm", "dust3r")  # initialisers whose poses no covariance vouches for; training refines them
FROM_IMAGES = ("auto", "pixels")  # supervisions that spans can be learnt by


def choose_spans(config: ReconstructionConfig, init: str, streams: Sequence[SpikeStream]) -> tuple[Span, ...]:
    """Return the spans that movers are learnt in: one, the whole, for a short recording or the method of a baseline."""
    planes = min(map(len, streams))
    if (len(cut(planes)) == 1 and config.span is None) or not _spanned(config, init):
        return (Span(0, planes),)
    return cut(planes, config.span or _most_planes(streams, planes))


def _most_planes(streams: Sequence[SpikeStream], planes: int) -> int:
    """Return the most planes of a span: more than usual where pixels in the light of a view fire seldom."""
    first = max(0, planes - SAMPLED) // 2
    parts = [stream.mapped(first, min(planes, first + SAMPLED)) for stream in streams[:SAMPLED_VIEWS]]
    spikes = float(np.mean([lit_spikes(part) / len(part) for part in parts]))
    return max(PLANES, math.ceil(min(LEAST_SPIKES / max(spikes, 1e-9), planes)))


def _spanned(config: ReconstructionConfig, init: str) -> bool:
    """Return whether what was asked for can be learnt in spans: our models, from images, with cameras that stay."""
    model = METHODS[BASES.name if config.model == "auto" else config.model]
    refines = config.refine == "on" or (config.refine == "auto" and init in UNADJUSTED)
    from_images = config.images not in GIVEN and config.supervision in FROM_IMAGES
    return model.ours and model.moves and not refines and from_images and config.points in ("auto", SWEPT)


def find_spans(
    streams: Mapping[str, SpikeStream], light: Light, spans: Sequence[Span], progress: Progress
) -> tuple[tuple[Span, ...], dict[str, NDArray[np.bool_]]]:
    """Return the spans with those at rest joined, and the pixels [S, H, W] of each view that see movers in each.

    What stands there while nothing moves is learnt once, however long that is.
    """
    masks: dict[str, NDArray[np.bool_]] = {}
    found = each(lambda stream: span_masks(stream, light, spans), streams.values())
    for view, mask in zip(streams, found, strict=True):
        masks[view] = mask
        progress(len(masks) / len(streams), f"movers of {view}")
    firsts = _firsts(spans, shares_of(masks), streams, light)
    ends = [spans[i].first for i in firsts] + [spans[-1].last]
    joined = tuple(Span(first, last) for first, last in pairwise(ends))
    return joined, {view: np.logical_or.reduceat(mask, firsts, axis=0) for view, mask in masks.items()}


def _firsts(
    spans: Sequence[Span], shares: NDArray[np.float64], streams: Mapping[str, SpikeStream], light: Light
) -> list[int]:
    """Return the numbers of the spans that begin one: all but those at rest that show what the one begun before does.

    What moves too slowly to be seen in a span is elsewhere in a later one, and a camera that was lost is dark.
    """
    firsts, shown = [0], None
    for i in range(1, len(spans)):
        rests = max(shares[i - 1], shares[i]) < STILL_SHARE
        if rests and shown is None:
            shown = _rates(streams, light, spans[i - 1])
        rates = _rates(streams, light, spans[i]) if rests else None
        if shown is None or rates is None or _unlike(rates, shown, len(spans[i])) >= STILL_SHARE:
            firsts.append(i)
            shown = rates
    return firsts


def _unlike(rates: Sequence[NDArray[np.float32]], shown: Sequence[NDArray[np.float32]], planes: int) -> float:
    """Return the share of the pixels of all views that do not show alike in two spans of so many planes."""
    return float(np.mean([unlike_share(*pair, planes) for pair in zip(rates, shown, strict=True)]))


def _rates(streams: Mapping[str, SpikeStream], light: Light, span: Span) -> list[NDArray[np.float32]]:
    """Return the mean light [H, W] of each view over a span, in spikes per tick under the usual light."""
    usual_planes = np.float32(len(span) * max(light.over(span.first, span.last), DARK))
    counts = each(lambda stream: stream.counts(span.first, span.last), streams.values())
    return [seen.astype(np.float32) / usual_planes for seen in counts]


def span_masks(stream: SpikeStream, light: Light, spans: Sequence[Span]) -> NDArray[np.bool_]:
    """Return the pixels [S, H, W] that see something move in each of S spans."""
    masks = []
    for span in spans:
        part, own = stream.part(span.first, span.last), Light(light.gains[span.first : span.last])
        masks.append(moving_pixels(part, own))
        stream.let_go()
    return np.stack(masks)


def shares_of(masks: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.float64]:
    """Return the share of the pixels that move in each span [S], of masks [S, H, W] by view."""
    return np.mean([mask.mean(axis=(1, 2)) for mask in masks.values()], axis=0)


def say_spans(spans: Sequence[Span], shares: NDArray[np.float64], share: float) -> Decision:
    """Return the decision to learn movers in spans; `share` of the pixels move where any do."""
    moving = int((shares >= STILL_SHARE).sum())
    reason = f"bodies are followed through {SWEEPS} instants of a span; what stands still is learnt once from all"
    facts = {"spans": len(spans), "moving_spans": moving, "moving_share": share}
    return Decision("spans", f"{len(spans)}, {moving} of them with movers", reason, "--span", facts=facts)
