"""Scores image networks while they learn: on random scenes of other seeds, and on `fan_and_ball`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.random.clutter import random_scene
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.metrics.image import psnr_db
from reconstruction.networks.training.clips import CameraClip, CameraClips, exposed
from rigs.toml import catalog_rig

RANDOM = CameraClips(first_seed=900_000, count=24, instants=(80,))
DEVELOPMENT_SEEDS = (1, 2, 3)
PLANES, INSTANT = 161, 80


@dataclass(frozen=True, eq=False)
class Scored:
    """A clip with one instant, the light of white there, and the pixels [H, W] that see a mover, where known."""

    clip: CameraClip
    white: float
    moving: NDArray[np.bool_] | None = None


def validation_clips(progress: Progress = silent) -> list[Scored]:
    """Make all clips a network is scored on: the `RANDOM` ones, then the centre camera's of the development seeds."""
    scored, seeds = [], (*RANDOM.seeds, *DEVELOPMENT_SEEDS)
    for seed in seeds:
        progress(len(scored) / len(seeds), f"validation clip {seed}")
        random = seed in RANDOM.seeds
        scored.append(Scored(RANDOM.make(seed), random_scene(seed).white) if random else _development_clip(seed))
    return scored


def validation_set() -> dict[str, list[int]]:
    """Return the seeds of the validation, for the document of a training."""
    return {"random_seeds": list(RANDOM.seeds), "fan_and_ball_seeds": list(DEVELOPMENT_SEEDS)}


def scores(image_of: Callable[[SpikeStream, int], NDArray[np.float32]], clips: list[Scored]) -> dict[str, float]:
    """Return the mean PSNR in dB over the random clips, the development clips, and the movers of the latter."""
    found: dict[str, list[float]] = {"random_db": [], "development_db": [], "moving_db": []}
    for scored in clips:
        image, truth = image_of(scored.clip.stream, scored.clip.instants[0]), scored.clip.truth[0]
        found["random_db" if scored.moving is None else "development_db"].append(psnr_db(image, truth, scored.white))
        if scored.moving is not None:
            found["moving_db"].append(psnr_db(image, truth, scored.white, scored.moving))
    return {name: float(np.mean(values)) for name, values in found.items() if values}


def _development_clip(seed: int) -> Scored:
    rig = catalog_rig("lab3x3")
    camera, scene = rig.camera("cam11"), build_scene("fan_and_ball", seed)
    sensor = Sensor(camera.width, camera.height, "real", seed, rig.ids.index("cam11"))
    frames = scene.render(camera, np.array([rig.clock.instant_s(INSTANT)]))
    moving = np.isin(frames.ids[0], list(scene.movers.values()))
    stream = exposed(scene, camera, rig.clock, PLANES, sensor)
    return Scored(CameraClip(stream, (INSTANT,), frames.intensity), scene.white, moving)
