"""Scores MSDI while it learns: on random rigs and scenes of other seeds, and on simulated recordings."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from acquisition.progress import Progress, silent
from acquisition.recording.reader import Recording
from acquisition.scenes.misplaced import misplaced
from reconstruction.metrics.depth import abs_rel
from reconstruction.metrics.image import psnr_db
from reconstruction.metrics.poses import pose_errors
from reconstruction.networks.msdi.inference import full_size, infer_views
from reconstruction.networks.msdi.network import Msdi
from reconstruction.networks.training.clips import MultiviewClip, MultiviewClips
from reconstruction.truth import Truth
from rigs.exchange.cameras import load_cameras
from rigs.rig import Rig
from rigs.similarity import align

FIRST_SEED, CLIPS = 900_000, 6  # of the random clips, which no training is of
RANDOM_ERROR = 2.0  # degrees, cm and percent of the nominal rigs of the random clips
HELD_OUT = "cam11"  # no initialiser sees it


@dataclass(frozen=True, eq=False)
class ScoredViews:
    """A clip to score on: its part of the validation (`random` or `development`), its scene and its nominal rig."""

    part: str
    scene: str
    clip: MultiviewClip
    nominal: Rig


def random_clips(kinds: tuple[str, ...], count: int = CLIPS) -> MultiviewClips:
    """Return the random clips to score on, of the kinds that are learnt from."""
    return MultiviewClips(FIRST_SEED, count, kinds=kinds)


def validation_set(random: MultiviewClips, development: Sequence[Path]) -> dict[str, object]:
    """Return what the validation consists of, for the document of a training."""
    names = [folder.name for folder in development]
    return {"random": asdict(random), "random_error": RANDOM_ERROR, "development": names}


def scored_views(
    random_set: MultiviewClips, development: Sequence[Path], progress: Progress = silent
) -> list[ScoredViews]:
    """Return the random clips, with nominal rigs off by RANDOM_ERROR, then the recordings in `development`."""
    random = []
    for seed in random_set.seeds:
        random.append(_random_views(random_set, seed))
        progress(len(random) / random_set.count, f"clip {seed}")
    return [*random, *map(recorded_views, development)]


def _random_views(random_set: MultiviewClips, seed: int) -> ScoredViews:
    clip = random_set.make(seed)
    return ScoredViews("random", random_set.kind(seed), clip, misplaced(clip.rig, RANDOM_ERROR, seed))


def recorded_views(folder: Path) -> ScoredViews:
    """Return a simulated recording at the truth nearest its middle, without the held-out camera."""
    recording, truth = Recording.open(folder), Truth.open(folder / "truth")
    ids = [c for c in recording.rig.ids if c != HELD_OUT]
    streams = tuple(recording.stream(c) for c in ids)
    chosen = min(truth.planes(ids[0]), key=lambda k: abs(k - len(streams[0]) // 2))
    frames = [truth.frame(c, chosen) for c in ids]
    light, depth = np.stack([f.intensity for f in frames]), np.stack([f.depth for f in frames])
    true = load_cameras(truth.path / "cameras.json", recording.rig.tick_rate_hz).only(ids)
    clip = MultiviewClip(streams, chosen, light, depth, truth.white, true)
    return ScoredViews("development", folder.name, clip, recording.rig.only(ids))


def scores(network: Msdi, scored: Sequence[ScoredViews]) -> dict[str, float]:
    """Return means over the random clips and over development: see `score`; the keys begin with `random` or so."""
    means = _means(network, scored, lambda one: one.part)
    return {f"{name}_{key}": value for name, found in means.items() for key, value in found.items()}


def scores_by_scene(network: Msdi, scored: Sequence[ScoredViews]) -> dict[str, dict[str, float]]:
    """Return means over the random clips of each kind and over each recording, by its name: see `score`."""
    return _means(network, scored, lambda one: one.scene)


def _means(
    network: Msdi, scored: Sequence[ScoredViews], name: Callable[[ScoredViews], str]
) -> dict[str, dict[str, float]]:
    found: dict[str, list[dict[str, float]]] = {}
    for one in scored:
        found.setdefault(name(one), []).append(score(network, one.clip, one.nominal))
    return {
        of: {key: float(np.mean([each[key] for each in several])) for key in several[0]}
        for of, several in found.items()
    }


def score(network: Msdi, clip: MultiviewClip, nominal: Rig) -> dict[str, float]:
    """Return the pose error in degrees and percent of the distance, the images' PSNR in dB, and depth's Abs Rel.

    Depth is that of the rig aligned to the true one, because the rig's own scale is free.
    """
    inferred = infer_views(network, clip.streams, nominal, clip.plane)
    rig = inferred.views.to_rig(nominal, inferred.factor)
    similarity = align(rig, clip.rig)
    errors = pose_errors(rig, clip.rig, inferred.views.distance)
    height, width = clip.light.shape[1:]
    relative = []
    for small, truth in zip(inferred.depth, clip.depth, strict=True):
        depth = similarity.scale * full_size(small, inferred.factor, height, width)
        relative.append(abs_rel(np.asarray(depth, np.float32), truth))
    return {
        "deg": errors.rotation_deg,
        "percent": errors.translation_percent,
        "db": float(np.mean([psnr_db(a, b, clip.white) for a, b in zip(inferred.light, clip.light, strict=True)])),
        "abs_rel": float(np.mean(relative)),
    }
