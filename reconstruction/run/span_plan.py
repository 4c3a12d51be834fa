"""Decides whether a recording is reconstructed in spans, and finds what moves in each."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import moving_pixels
from reconstruction.images.catalogue import GIVEN
from reconstruction.images.flicker import Light
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.ours import BASES
from reconstruction.parallel import each
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.decisions import Decision
from reconstruction.run.prices import INSTANTS
from reconstruction.run.spans import PLANES, STILL_SHARE, Span, cut

UNADJUSTED = ("sfm", "dust3r")  # initialisers whose poses no covariance vouches for; training refines them
FROM_IMAGES = ("auto", "pixels")  # supervisions that spans can be learnt by


def choose_spans(config: ReconstructionConfig, init: str, planes: int) -> tuple[Span, ...]:
    """Return the spans that movers are learnt in: one, the whole, for a short recording or the method of a baseline."""
    spans = cut(planes, config.span or PLANES)
    return spans if _spanned(config, init) else (Span(0, planes),)


def _spanned(config: ReconstructionConfig, init: str) -> bool:
    """Return whether what was asked for can be learnt in spans: our models, from images, with cameras that stay."""
    model = METHODS[BASES.name if config.model == "auto" else config.model]
    refines = config.refine == "on" or (config.refine == "auto" and init in UNADJUSTED)
    from_images = config.images not in GIVEN and config.supervision in FROM_IMAGES
    return model.ours and model.moves and not refines and from_images


def moving_masks(
    streams: Mapping[str, SpikeStream], light: Light, spans: Sequence[Span], progress: Progress
) -> dict[str, NDArray[np.bool_]]:
    """Return the pixels [S, H, W] of each view that see something move in each of S spans."""
    masks: dict[str, NDArray[np.bool_]] = {}
    for view, found in zip(
        streams, each(lambda stream: span_masks(stream, light, spans), streams.values()), strict=True
    ):
        masks[view] = found
        progress(len(masks) / len(streams), f"movers of {view}")
    return masks


def span_masks(stream: SpikeStream, light: Light, spans: Sequence[Span]) -> NDArray[np.bool_]:
    """Return the pixels [S, H, W] that see something move in each of S spans."""
    parts = [(stream.part(s.first, s.last), Light(light.gains[s.first : s.last])) for s in spans]
    return np.stack([moving_pixels(*part) for part in parts])


def shares_of(masks: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.float64]:
    """Return the share of the pixels that move in each span [S], of masks [S, H, W] by view."""
    return np.mean([mask.mean(axis=(1, 2)) for mask in masks.values()], axis=0)


def say_spans(spans: Sequence[Span], shares: NDArray[np.float64], share: float) -> Decision:
    """Return the decision to learn movers in spans; `share` of the pixels move where any do."""
    reason = f"bodies are followed through {INSTANTS} instants of a span; what stands still is learnt once from all"
    facts = {"spans": len(spans), "moving_spans": int((shares >= STILL_SHARE).sum()), "moving_share": share}
    return Decision("spans", f"{len(spans)} of {len(spans[0])} planes", reason, "--span", facts=facts)
