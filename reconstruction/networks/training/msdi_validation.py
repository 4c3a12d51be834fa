"""How good MSDI is while it learns: random rigs and scenes of other seeds, and recordings of the development scene."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch import nn

from acquisition.progress import Progress, silent
from acquisition.recording.reader import Recording
from acquisition.scenes.misplaced import misplaced
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.metrics.depth import abs_rel
from reconstruction.metrics.image import psnr_db
from reconstruction.metrics.poses import pose_errors
from reconstruction.networks.msdi.inference import full_size, infer_views
from reconstruction.networks.msdi.network import Msdi
from reconstruction.networks.msdi.views import Views
from reconstruction.networks.training.msdi_clips import MultiviewSet, make_clip
from rigs.exchange.cameras import load_cameras
from rigs.rig import Rig
from rigs.similarity import align

RANDOM = MultiviewSet(first_seed=900_000, count=4)
RANDOM_ERROR = 2.0  # degrees, cm and percent of the nominal rigs of the random clips
HELD_OUT = "cam11"  # no initialiser sees it


@dataclass(frozen=True, eq=False)
class Scored:
    """Streams around `plane` with the true `light` and `depth` [V, h, w], the true and the nominal rig."""

    name: str
    streams: Sequence[SpikeStream]
    plane: int
    light: NDArray[np.float32]
    depth: NDArray[np.float32]
    white: float
    true: Rig
    nominal: Rig


def random_views() -> list[Scored]:
    """The random clips, with nominal rigs off by RANDOM_ERROR."""
    scored = []
    for seed in RANDOM.seeds:
        clip = make_clip(RANDOM, seed)
        nominal = misplaced(clip.rig, RANDOM_ERROR, seed)
        scored.append(Scored("random", clip.streams, clip.plane, clip.light, clip.depth, clip.white, clip.rig, nominal))
    return scored


def recorded_views(folder: Path, plane: int | None = None) -> Scored:
    """A simulated recording at `plane` (default: the truth nearest the middle), without the held-out camera."""
    recording = Recording.open(folder)
    truth = folder / "truth"
    if not truth.is_dir():
        raise BadRunError("found no truth", "a simulated recording to score on", where=folder)
    nominal = recording.rig
    ids = [c for c in nominal.ids if c != HELD_OUT]
    streams = [recording.stream(c) for c in ids]
    planes = sorted(int(path.stem) for path in (truth / ids[0]).glob("[0-9]*.npy"))
    chosen = plane if plane is not None else min(planes, key=lambda k: abs(k - len(streams[0]) // 2))
    light, depth = (
        np.stack([np.load(truth / c / f"{prefix}{chosen:06d}.npy") for c in ids]) for prefix in ("", "depth_")
    )
    true = load_cameras(truth / "cameras.json", nominal.tick_rate_hz).only(ids)
    white = float(json.loads((truth / "scene.json").read_text())["white"])
    return Scored("development", streams, chosen, light, depth, white, true, nominal.only(ids))


def scores(network: nn.Module, scored: Sequence[Scored], progress: Progress = silent) -> dict[str, float]:
    """Means over each kind of view: pose error in degrees and percent of the distance, image dB, depth's Abs Rel."""
    assert isinstance(network, Msdi)
    found: dict[str, list[float]] = {}
    for number, one in enumerate(scored):
        progress(number / len(scored), f"scoring {one.name}")
        for name, value in score(network, one).items():
            found.setdefault(f"{one.name}_{name}", []).append(value)
    return {name: float(np.mean(values)) for name, values in found.items()}


def score(network: Msdi, one: Scored) -> dict[str, float]:
    """The errors of one instant; depth is that of the rig aligned to the true one, as the rig's own scale is free."""
    inferred = infer_views(network, one.streams, Views.of_rig(one.nominal), one.plane)
    rig = inferred.views.to_rig(one.nominal, inferred.factor)
    similarity = align(rig, one.true)
    distance = inferred.views.distance
    errors = pose_errors(rig, one.true, distance)
    height, width = one.light.shape[1:]
    relative = []
    for small, truth in zip(inferred.depth, one.depth, strict=True):
        depth = similarity.scale * full_size(small, inferred.factor, height, width)
        relative.append(abs_rel(np.asarray(depth, np.float32), truth))
    return {
        "deg": errors.rotation_deg,
        "percent": errors.translation_percent,
        "db": float(np.mean([psnr_db(a, b, one.white) for a, b in zip(inferred.light, one.light, strict=True)])),
        "abs_rel": float(np.mean(relative)),
    }
